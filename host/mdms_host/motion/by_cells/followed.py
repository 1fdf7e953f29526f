"""A parcel that its cells steer, as the host follows it: its way, and whether it gets on."""

from math import hypot, inf, radians, sqrt

from mdms_host.motion.goal import Goal, Limits
from mdms_host.motion.outcome import REACHED_M, REACHED_RAD, miss_of
from mdms_host.motion.standstill import Standstill
from mdms_model.arrays import Floats

#: A parcel has arrived where it is believed within this of its goal.
ARRIVED_M, ARRIVED_RAD = 0.003, radians(1.0)


class Followed:
    """Compares the pose of a parcel with the aim that its program gives the cells.

    `left_m` is the way that is left to go, a corner's way included, inf before it is known.
    `speed_m_s` is how fast the program has the parcel go from there, 0 while it must not move. Both
    are of the `place` to which the parcel goes now, which may be on the way to its `goal`.
    `reported` is whether the cells report the parcel at that place, `there` whether the host's own
    estimate does not contradict this, and `arrived` whether it is at its goal. `overtaken` is set
    when the cells have gone on to the next leg.
    """

    def __init__(self, goal: Goal, limits: Limits, reach_m: float) -> None:
        self.goal = goal
        self.place = goal
        self.left_m = inf
        self.speed_m_s = 0.0
        self.reported = False
        self.there = False
        self.arrived = False
        self.stopped = False
        self.overtaken = False
        self.miss: tuple[float, float] | None = None
        self._limits = limits
        self._reach_m = reach_m
        self._standstill = Standstill()

    def lose(self) -> None:
        """Where the parcel is is not known."""
        self.left_m, self.speed_m_s, self.miss = inf, 0.0, None
        self.reported = self.there = self.arrived = False
        self._standstill.clear()

    def lead(self, place: Goal) -> None:
        """The cells are to take it there now."""
        if place != self.place:
            self.place = place
            self._standstill.clear()

    def see(self, pose: Floats, arrived: bool, may_move: bool, step_s: float) -> bool:
        """Take in the believed pose of the parcel; returns whether it stands against the plan.

        `arrived` is the cells' report of the place, `may_move` whether nothing holds them.
        """
        self.miss = miss_of(self.place, *pose.tolist())
        off_m, off_rad = self.miss
        self.left_m = hypot(off_m, off_rad * self._reach_m)
        final = self.place is self.goal
        most_m, most_rad = (ARRIVED_M, ARRIVED_RAD) if final else (REACHED_M, REACHED_RAD)
        self.reported = arrived
        self.there = arrived and off_m <= most_m and abs(off_rad) <= most_rad
        self.arrived = self.there and final
        steered = may_move and not arrived and not self.stopped
        self.speed_m_s = self._planned_m_s() if steered else 0.0
        if not steered:
            self._standstill.clear()
            return False
        return self._standstill.step(self.left_m, self.speed_m_s, step_s)

    def _planned_m_s(self) -> float:
        limits = self._limits
        braking_m_s = sqrt(limits.acceleration_m_s2 * self.left_m)
        return min(limits.speed_m_s, limits.stiffness_per_s * self.left_m, braking_m_s)
