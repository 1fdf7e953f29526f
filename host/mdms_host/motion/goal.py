"""Closed-loop steering of one parcel to a goal pose, as fast as its wheels still roll."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import hypot, inf

import numpy as np

from mdms_host.estimation.belief import Belief
from mdms_host.motion.footholds import Footholds
from mdms_host.motion.trajectory.follower import STIFFNESS_PER_S, Carried, Follower, Grip
from mdms_host.motion.trajectory.path import Path, shorter_turn_rad
from mdms_host.motion.trajectory.pushes import Mass
from mdms_host.motion.trajectory.traction import Traction
from mdms_model.arrays import Floats

#: So often a parcel moves to have its place made sure; a goal without a yaw is where it is then. If
#: it may still be beside its goal, it moves so often.
_MOVES = 3
_MOST_MOVES = 4
#: A target that differs by less is the same.
_SAME_M = 1e-6
#: A parcel that is farther from where it was a step before has been put there by hand [m].
PUT_M = 0.02
#: At the end of its way a parcel is drawn to the goal by the rest of the way, so much at most [m].
_CREEP_M = 0.006


@dataclass(frozen=True, slots=True)
class GoalPose:
    """The pose that a parcel is steered to [table frame], and when it counts as reached.

    `yaw_rad` None leaves the parcel turned as it is.
    """

    x_m: float
    y_m: float
    yaw_rad: float | None = 0.0
    tolerance_m: float = 0.002
    tolerance_rad: float = 0.01
    settle_s: float = 0.3


@dataclass(frozen=True, slots=True)
class Limits:
    """How fast cells that steer may move a parcel.

    `speed_m_s` bounds the speed of its centre and of its corners' turning together; the
    acceleration takes at most `friction_share` of what friction can give (mu g).
    """

    speed_m_s: float = 0.1
    friction: float = 0.3
    friction_share: float = 0.15
    gravity_m_s2: float = 9.81
    stiffness_per_s: float = 3.0

    @property
    def acceleration_m_s2(self) -> float:
        """Greatest acceleration [m/s2] at which wheels are taken to roll."""
        return self.friction_share * self.friction * self.gravity_m_s2


def next_move(
    goal: GoalPose, belief: Belief, moves: Iterable[Floats], made: int, footholds: Footholds
) -> Floats | None:
    """The first of these moves, (3,), that a parcel at its goal may make to be felt, or None.

    It has made so many. A turn is not told where the parcel might tip.
    """
    if made >= (_MOVES if belief.is_sure(turned=goal.yaw_rad is not None) else _MOST_MOVES):
        return None
    safe = (move for move in moves if not move[:2].any() or footholds.stand(belief, move))
    return next(safe, None)


class GoalController:
    """Takes one parcel to a goal, straight; `arrived` once it is there.

    Translation and rotation are one motion, so that both end together. A parcel that has arrived is
    held until a sensor shows it outside twice the tolerance. A parcel that is `paused` is brought
    to rest meanwhile. A parcel that has left its way comes to rest, and takes another from there.

    A place is not sure enough while a move of `feel` would show it better. A parcel there moves so
    first, three times at most, and back. If it may still be beside its goal, it moves once more.
    `moves` counts that, until it has arrived for sure. `leg` counts these ways, and each time that
    the parcel has been put elsewhere.
    """

    def __init__(self, goal: GoalPose, traction: Traction, mass: Mass) -> None:
        self.goal = goal
        self.arrived = False
        self.paused = False
        self.feel: Sequence[Floats] = ()
        self.grip = Grip()
        self._traction = traction
        self._mass = mass
        #: Whether it has moved away to be felt, and is not back yet.
        self.feels = False
        self._felt: Floats | None = None
        #: The yaw to turn back to, of a goal without one whose parcel is felt [rad].
        self._back_rad: float | None = None
        self.moves = 0
        self.leg = 0
        self._follower: Follower | None = None
        self._left_m = inf
        self._within_s = 0.0
        self._pose: Floats | None = None

    def go_on_with(self, follower: Follower) -> None:
        """Begin with the motion that this follower of the parcel has commanded last."""
        self._follower, self.grip = follower, follower.grip

    @property
    def left_m(self) -> float:
        """The way left at the last step, a corner's way included [m]; inf before it."""
        return self._left_m

    @property
    def settling(self) -> bool:
        """Whether the parcel is within its tolerance, and has not been there for long enough."""
        return self._within_s > 0.0 and not self.arrived

    @property
    def may_feel(self) -> bool:
        """Whether moves of `feel` count in the next step: it is about to arrive, or is felt."""
        return self.settling or self._felt is not None

    @property
    def speed_m_s(self) -> float:
        """How fast the parcel is commanded to go there, a corner's way included [m/s]."""
        if self._follower is None:
            return 0.0
        if self._follower.off_path:
            return 0.0
        if self._still or not self._follower.reference.finished:
            return self._follower.reference.speed_m_s
        return STIFFNESS_PER_S * min(self._left_m, _CREEP_M)

    @property
    def _still(self) -> bool:
        return self.paused or self.arrived

    def step(self, belief: Belief, step_s: float) -> Carried | None:
        """The motion of the parcel's wheels in the next step; None: stand still."""
        if self._pose is not None and hypot(*(belief.pose - self._pose)[:2].tolist()) > PUT_M:
            # The slip may have been the parcel's leaving; its way begins anew.
            self.grip = Grip()
            self._back_rad = None
            self.leg += 1
        self._pose = belief.pose
        off = self._target(belief.pose) - belief.pose
        self._left_m = self._left_along_m(off, belief)
        if belief.corrected or not self.arrived:
            self._check_arrival(off, belief, step_s)
        follower = self._following(belief)
        if follower is None:
            return None
        follower.paused = self._still or self._leads_elsewhere(follower, belief.pose)
        return follower.step(belief, step_s)

    def _left_along_m(self, off: Floats, belief: Belief) -> float:
        """The way left straight to the target, or on a way with corners along that."""
        follower = self._follower
        if follower is None or follower.reference.finished or len(follower.profile.path.pieces) < 2:
            return hypot(off[0], off[1], off[2] * belief.outline.reach_m)
        path, s_m = follower.profile.path, follower.reference.s_m
        return path.length_m - s_m + path.distance_m(path.off(belief.pose, s_m))

    def _following(self, belief: Belief) -> Follower | None:
        """The follower of the way to the present target; None where the parcel is to stand."""
        follower = self._follower
        if follower is not None and not follower.reference.at_rest:
            return follower
        if self._still:
            self._follower = None
            return None
        if follower is None or follower.off_path or self._leads_elsewhere(follower, belief.pose):
            if follower is not None and follower.off_path:
                self.leg += 1
            self._follower = self._straight(belief)
        return self._follower

    def _straight(self, belief: Belief) -> Follower:
        """The follower of the straight way from here."""
        ends = np.array([belief.pose, self._target(belief.pose)])
        path = Path(ends, belief.outline.reach_m)
        profile = self._traction.profile(path, belief.outline, self._mass)
        return Follower(self._traction, profile, self.grip)

    def _leads_elsewhere(self, follower: Follower, pose: Floats) -> bool:
        """Whether a way does not end where the parcel is to be now, or with the wheels of now."""
        if follower.out_of_date:
            return True
        off = follower.profile.path.off(self._target(pose), follower.profile.path.length_m)
        return follower.profile.path.distance_m(off) > _SAME_M

    def _target(self, pose: Floats) -> Floats:
        """The pose to be at, in the turn nearest to a pose, shape (3,)."""
        if self._felt is not None:
            return self._felt
        wanted_rad, yaw_rad = self.goal.yaw_rad, float(pose[2])
        if wanted_rad is None:
            wanted_rad = self._back_rad
        if wanted_rad is None:
            # However the parcel is turned when it sets out.
            follower = self._follower
            turned_rad = yaw_rad if follower is None else float(follower.profile.path.end[2])
        else:
            turned_rad = yaw_rad + shorter_turn_rad(yaw_rad, wanted_rad)
        return np.array([self.goal.x_m, self.goal.y_m, turned_rad])

    def _check_arrival(self, off: Floats, belief: Belief, step_s: float) -> None:
        """Arrived after a while within the tolerance; gone again outside twice of it.

        A doubtful parcel does not arrive before sensors show it again, nor does any while they are
        wrong too often.
        """
        slack = 2.0 if self.arrived else 1.0
        x_m, y_m, turn_rad = off.tolist()
        if self.goal.yaw_rad is None and self._back_rad is None:
            turn_rad = 0.0
        within = (
            hypot(x_m, y_m) <= slack * self.goal.tolerance_m
            and abs(turn_rad) <= slack * self.goal.tolerance_rad
        )
        if belief.noisy:
            # It waits there, and its time begins anew.
            self._within_s = 0.0
        self._within_s = self._within_s + step_s if within and not belief.doubtful else 0.0
        self._feel(belief, settled=self._within_s >= self.goal.settle_s)
        within &= self._felt is None
        self.feels &= self._felt is not None or self._within_s == 0.0
        self.arrived = within and (self.arrived or self._within_s >= self.goal.settle_s)
        if self.arrived and belief.is_sure(turned=self.goal.yaw_rad is not None):
            self.moves = 0

    def _feel(self, belief: Belief, *, settled: bool) -> None:
        """Move away from the goal while that shows the place better, and back when it is sure."""
        if self.arrived:
            self._back_rad = None
            return
        move = self.feel[0] if self.feel else None
        if settled and self.feel:
            footholds = Footholds(self._traction.layout, belief.outline, self._mass.centre_m)
            move = next_move(self.goal, belief, self.feel, self.moves, footholds)
        if move is None:
            if self._felt is not None:
                self._felt, self._within_s = None, 0.0
                self.leg += 1
        elif settled:
            x_m, y_m, turn_rad = move.tolist()
            end = self.goal.x_m + x_m, self.goal.y_m + y_m, float(belief.pose[2]) + turn_rad
            self._felt, self._within_s = np.array(end), 0.0
            if self.goal.yaw_rad is None and not self.feels:
                self._back_rad = float(belief.pose[2])
            self.feels = True
            self.moves += 1
            self.leg += 1
