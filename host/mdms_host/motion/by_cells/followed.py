"""The way of a parcel that its cells steer, as the host follows it, and its end.

Cells go straight at one place, and report a parcel at its goal by their own belief. If the place at
the goal is not sure enough, the host has them move the parcel until an edge has shown it, as
`motion.goal` does.
"""

from math import hypot, inf, radians, sqrt

from mdms_host.estimation.belief import Belief
from mdms_host.motion.footholds import Footholds
from mdms_host.motion.goal import PUT_M, GoalPose, Limits, next_move
from mdms_host.motion.outcome import REACHED_M, REACHED_RAD, Standstill, miss_of
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

    def __init__(self, goal: GoalPose, limits: Limits, reach_m: float) -> None:
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

    def lead(self, place: GoalPose) -> None:
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


class LastLeg:
    """The places of the last leg of a parcel: its goal, and before it one to be `felt` at, if any.

    A belief has only those moves that would make it surer (`feel`) for which there is room.
    """

    def __init__(self, goal: GoalPose, footholds: Footholds) -> None:
        self.places: tuple[GoalPose, ...] = (goal,)
        self._goal = goal
        self._footholds = footholds
        self._moves = 0
        self._pose: Floats | None = None

    @property
    def felt(self) -> bool:
        """Whether the parcel is moved away from its goal to be felt."""
        return len(self.places) > 1

    def step(self, belief: Belief, reported: bool, there: bool) -> bool:
        """Take in whether the cells report the parcel at the first place, and it is believed there.

        Returns whether it is at its goal, as surely as can be. Where it is not known well, an edge
        decides whether the report or the belief is right. A parcel that is elsewhere at once has
        been put there, or never was where it was believed.
        """
        if self._pose is not None and hypot(*(belief.pose - self._pose)[:2].tolist()) > PUT_M:
            self.places = (self._goal,)
        self._pose = belief.pose
        if self.felt:
            if reported or not belief.feel:
                self.places = (self._goal,)
            return False
        move = next_move(self._goal, belief, belief.feel, self._moves, self._footholds)
        if move is None:
            return there and not belief.noisy
        if reported:
            self._move(belief, move)
        return False

    def overtaken(self) -> None:
        """The cells have gone on to the next place by themselves."""
        self.places = (self._goal,)

    def _move(self, belief: Belief, move: Floats) -> None:
        goal, yaw_rad = self._goal, float(belief.pose[2])
        x_m, y_m, turn_rad = move.tolist()
        self.places = (GoalPose(goal.x_m + x_m, goal.y_m + y_m, yaw_rad + turn_rad), goal)
        self._moves += 1
