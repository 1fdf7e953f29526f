"""Whether parcels have come to their goals, and whether they get on towards them.

A parcel stands that makes hardly any way though it is commanded to move.
"""

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import degrees, hypot

from mdms_host.motion.goal import GoalPose
from mdms_host.motion.trajectory.path import shorter_turn_rad

#: A parcel within this of its goal has reached it. The coordinator steers to within 2 mm by its
#: belief. The rest is the error of a belief after the last edge of the way.
REACHED_M = 0.005
REACHED_RAD = 0.03


@dataclass(frozen=True, slots=True)
class GoalOutcome:
    """How far a parcel is from its goal at the end, and when it came there to stay [s].

    Errors are None where the parcel is off the table or has not been found, the time where it has
    not arrived.
    """

    parcel: str
    reached: bool
    position_error_m: float | None
    yaw_error_rad: float | None
    time_s: float | None

    @property
    def text(self) -> str:
        """The distance left, in words."""
        if self.position_error_m is None or self.yaw_error_rad is None:
            return f"{self.parcel} is not on the table, or has not been found"
        return (
            f"{self.parcel} is {1e3 * self.position_error_m:.1f} mm and "
            f"{degrees(abs(self.yaw_error_rad)):.1f} degrees from its goal"
        )


def miss_of(goal: GoalPose, x_m: float, y_m: float, yaw_rad: float) -> tuple[float, float]:
    """How far a pose is from a goal: distance [m], and the shorter turn away from it [rad].

    A goal without a yaw is reached however the parcel is turned.
    """
    wanted_rad = yaw_rad if goal.yaw_rad is None else goal.yaw_rad
    turn_rad = shorter_turn_rad(wanted_rad, yaw_rad)
    return hypot(x_m - goal.x_m, y_m - goal.y_m), turn_rad


def outcome_of(
    parcel: str, goal: GoalPose, pose: tuple[float, float, float] | None, time_s: float | None
) -> GoalOutcome:
    """The outcome for a parcel at a pose; `time_s` is when it came there, if it is there."""
    if pose is None:
        return GoalOutcome(parcel, False, None, None, None)
    miss_m, miss_rad = miss_of(goal, *pose)
    reached = miss_m <= REACHED_M and abs(miss_rad) <= REACHED_RAD
    return GoalOutcome(parcel, reached, miss_m, miss_rad, time_s if reached else None)


def missed_text(outcomes: Iterable[GoalOutcome], unsure: Mapping[str, str]) -> str | None:
    """The goals that were not reached, in one line; None if all were.

    `unsure` has the parcels that may be beside the goals that they have come to, in words.
    """
    missed = [each.text for each in outcomes if not each.reached and each.parcel not in unsure]
    missed += unsure.values()
    return f"goal not reached: {'; '.join(missed)}" if missed else None


#: A parcel stands when it has made less than this share of the commanded way in either half of the
#: window: an edge that corrects the belief spoils one half at most.
_HALF_S = 0.4
_SHARE = 0.2
#: A commanded way too short to judge by [m].
_LEAST_M = 0.0015
#: However slowly it is to go, it stands when it has made less than this way in so long.
_LONG_S = 1.6
_CREEP_M = 0.0005


class Standstill:
    """Compares the way that a parcel has made with the way it was commanded to make."""

    def __init__(self) -> None:
        self._lately: deque[tuple[float, float]] = deque()
        self._commanded_m = 0.0
        self._leg = 0

    def step(self, left_m: float, speed_m_s: float, step_s: float, leg: int = 0) -> bool:
        """Take in the way left and the commanded speed; whether the parcel stands.

        On another `leg` of its way, which leads elsewhere, the comparison begins anew.
        """
        if leg != self._leg:
            self._leg = leg
            self.clear()
        half, long = round(_HALF_S / step_s), round(_LONG_S / step_s)
        self._commanded_m += speed_m_s * step_s
        self._lately.append((left_m, self._commanded_m))
        if len(self._lately) > long + 1:
            self._lately.popleft()
        if len(self._lately) <= 2 * half:
            return False
        first, middle, last = (self._lately[-1 - before] for before in (2 * half, half, 0))
        creeps = len(self._lately) > long and _creeps(self._lately[0], last)
        return creeps or (_stands(first, middle) and _stands(middle, last))

    def clear(self) -> None:
        """Begin anew: the parcel has been still, or out of sight."""
        self._lately.clear()


def _stands(before: tuple[float, float], after: tuple[float, float]) -> bool:
    commanded_m, made_m = after[1] - before[1], before[0] - after[0]
    return commanded_m >= _LEAST_M and made_m < _SHARE * commanded_m


def _creeps(before: tuple[float, float], after: tuple[float, float]) -> bool:
    """Whether it has made hardly any way, though it was commanded to go."""
    return after[1] > before[1] and before[0] - after[0] < _CREEP_M
