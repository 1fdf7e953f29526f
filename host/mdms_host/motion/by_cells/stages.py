"""The way of a parcel that its cells steer, as the host follows it, and the next places on it.

Cells go straight at one place, and report a parcel at its goal by their own belief. So the host
gives them the corners of a safe way one after another: around places where it might tip, and turned
there. If the place at the goal is not sure enough, it has them move the parcel until an edge has
shown it, as `motion.goal` does.
"""

from collections.abc import Callable
from math import hypot, inf, radians, sqrt

import numpy as np

from mdms_host.estimation.belief import Belief
from mdms_host.motion.footholds import Footholds
from mdms_host.motion.goal import PUT_M, Goal, Limits, next_move
from mdms_host.motion.outcome import REACHED_M, REACHED_RAD, Standstill, miss_of
from mdms_host.motion.way_search import WaySearch
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


#: A parcel is at a corner, from where it goes on to the next place, within this [m].
_CORNER_M = 0.008


class Stages:
    """The places that a parcel is still to be taken to; `places` is empty while they are sought.

    The goal is the last of them; `felt` is whether it is moved there now to be felt. A belief has
    only those moves that would make it surer (`feel`) for which there is room. `has_room` is
    whether a way may lead around, given the pose to go to. A parcel that is `led` is on the last
    leg of a way of the caller's, so no way is sought.
    """

    def __init__(
        self,
        goal: Goal,
        footholds: Footholds,
        has_room: Callable[[Floats], bool] = lambda _: True,
        *,
        led: bool = False,
    ) -> None:
        self.places: tuple[Goal, ...] = (goal,) if led else ()
        self.led = led
        self._goal = goal
        self._footholds = footholds
        self._has_room = has_room
        self._search: WaySearch | None = None
        self._moves = 0
        self._pose: Floats | None = None
        self.felt = False

    @property
    def final(self) -> bool:
        """Whether the parcel is taken to its goal now."""
        return len(self.places) == 1

    def step(self, belief: Belief, reported: bool, there: bool) -> bool:
        """Take in whether the cells report the parcel at the first place, and it is believed there.

        Returns whether it is at its goal, as surely as can be. Where it is not known well, an edge
        decides whether the report or the belief is right. A parcel that is elsewhere at once has
        been put there, or never was where it was believed: its way is sought anew.
        """
        if self._pose is not None and hypot(*(belief.pose - self._pose)[:2].tolist()) > PUT_M:
            self.places, self.felt, self._search = (self._goal,) if self.led else (), False, None
        self._pose = belief.pose
        if not self.places:
            self._seek(belief)
        elif self.felt:
            self._move_back(belief, reported)
        elif not self.final:
            if there or _away_m(self.places[0], belief) <= _CORNER_M:
                self.places = self.places[1:]
        elif (
            move := next_move(self._goal, belief, belief.feel, self._moves, self._footholds)
        ) is not None:
            if reported:
                self._move(belief, move)
        else:
            return there and not belief.noisy
        return False

    def overtaken(self) -> None:
        """The cells have gone on to the next place by themselves."""
        self.places, self.felt = self.places[1:] or self.places, False

    def _seek(self, belief: Belief) -> None:
        goal, pose = self._goal, belief.pose
        yaw_rad = float(pose[2]) if goal.yaw_rad is None else goal.yaw_rad
        if self._search is None:
            end = np.array([goal.x_m, goal.y_m, yaw_rad])
            self._search = WaySearch(self._footholds, belief, end, room=self._has_room(end))
        path = self._search.step()
        if path is not None:
            corners = (path.pose_at(s_m).tolist() for s_m in path.corners_m[:-1])
            self.places = (*(Goal(*corner) for corner in corners), goal)

    def _move(self, belief: Belief, move: Floats) -> None:
        goal, yaw_rad = self._goal, float(belief.pose[2])
        x_m, y_m, turn_rad = move.tolist()
        self.places = (Goal(goal.x_m + x_m, goal.y_m + y_m, yaw_rad + turn_rad), goal)
        self.felt = True
        self._moves += 1

    def _move_back(self, belief: Belief, reported: bool) -> None:
        if reported or not belief.feel:
            self.places, self.felt = (self._goal,), False


def _away_m(place: Goal, belief: Belief) -> float:
    """How far a parcel is from a place, a corner's way included [m]."""
    off_m, off_rad = miss_of(place, *belief.pose.tolist())
    return hypot(off_m, off_rad * belief.outline.reach_m)
