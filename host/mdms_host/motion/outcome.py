"""Whether parcels have come to their goals, and how far off the others are."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import degrees, hypot

from mdms_host.motion.goal import Goal
from mdms_host.motion.trajectory.path import shorter_turn_rad

#: A parcel within this of its goal has reached it. The coordinator steers to within 2 mm by its
#: belief. The rest is the error of a belief after the last edge of the way.
REACHED_M = 0.005
REACHED_RAD = 0.03


@dataclass(frozen=True, slots=True)
class GoalOutcome:
    """How far a parcel is from its goal at the end, and when it came there to stay [s].

    Errors are None where the parcel has not been found, the time where it has not arrived.
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
            return f"{self.parcel} has not been found"
        return (
            f"{self.parcel} is {1e3 * self.position_error_m:.1f} mm and "
            f"{degrees(abs(self.yaw_error_rad)):.1f} degrees from its goal"
        )


def miss_of(goal: Goal, x_m: float, y_m: float, yaw_rad: float) -> tuple[float, float]:
    """How far a pose is from a goal: distance [m], and the shorter turn away from it [rad].

    A goal without a yaw is reached however the parcel is turned.
    """
    wanted_rad = yaw_rad if goal.yaw_rad is None else goal.yaw_rad
    turn_rad = shorter_turn_rad(wanted_rad, yaw_rad)
    return hypot(x_m - goal.x_m, y_m - goal.y_m), turn_rad


def outcome_of(
    parcel: str, goal: Goal, pose: tuple[float, float, float] | None, time_s: float | None
) -> GoalOutcome:
    """The outcome for a parcel at a pose; `time_s` is when it came there, if it is there."""
    if pose is None:
        return GoalOutcome(parcel, False, None, None, None)
    miss_m, miss_rad = miss_of(goal, *pose)
    reached = miss_m <= REACHED_M and abs(miss_rad) <= REACHED_RAD
    return GoalOutcome(parcel, reached, miss_m, miss_rad, time_s if reached else None)


def missed_text(outcomes: Iterable[GoalOutcome]) -> str | None:
    """The goals that were not reached, in one line; None if all were."""
    missed = [outcome.text for outcome in outcomes if not outcome.reached]
    return f"goal not reached: {'; '.join(missed)}" if missed else None
