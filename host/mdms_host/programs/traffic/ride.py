"""The ride of one parcel: its interface, the ride that the host drives, and all ways and times.

A parcel goes along its route as far as that is free, and is then held at its goal, or has left."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from mdms_host.estimation.belief import Belief
from mdms_host.estimation.footprint import Footprint
from mdms_host.motion.goal import GoalController, GoalPose
from mdms_host.motion.outcome import Standstill
from mdms_host.motion.trajectory.follower import Carried, Follower, Grip
from mdms_host.motion.trajectory.path import Path
from mdms_host.motion.trajectory.pushes import Mass
from mdms_host.motion.trajectory.speed_profile import SpeedProfile
from mdms_host.motion.trajectory.traction import Traction
from mdms_host.programs.order import Gate, Order
from mdms_host.routes.route import Route
from mdms_model.arrays import Floats


class Riding(Protocol):
    """One parcel under way on a route, by whomever it is driven; see `ride.Ride`."""

    order: Order
    route: Route
    stopping: bool
    obstructed: bool

    @property
    def progress_m(self) -> float:
        """The path coordinate that the parcel has come to, as is believed [m]."""
        ...

    @property
    def at_rest(self) -> bool:
        """Whether it is commanded to stand."""
        ...

    @property
    def off_path(self) -> bool:
        """Whether it has left its route, and needs another."""
        ...

    @property
    def stands(self) -> bool:
        """Whether it does not get on though it is commanded to."""
        ...

    @property
    def has_come(self) -> bool:
        """Whether the way is done, and the parcel is brought to the goal itself, or held there."""
        ...

    @property
    def arrived(self) -> bool:
        """Whether the parcel is at its goal and has settled."""
        ...

    def has_left(self, belief: Belief | None, last: Floats) -> bool:
        """Whether it has left, given its present belief, and its last believed pose."""
        ...


#: Rounding, of the length of a way [m].
_SAME_M = 1e-9
#: A parcel that leaves is driven as if its way went on so far beyond its end [m].
_ONWARD_M = 0.4
#: Less than this share of the usual acceleration is for want of wheels at the edge.
_WEAK_SHARE = 0.5
#: A parcel that is believed nowhere any more has left from so far before the last support on [m].
_NEARLY_OUT_M = -0.08
#: The last part of a way, which is one motion with settling at a goal that is kept [m].
_LAST_M = 0.01
#: A parcel that has come to its goal and is farther from it by now needs another way [m].
_ASTRAY_M = 0.03


@dataclass(frozen=True, slots=True)
class Load:
    """The known properties of a parcel."""

    footprint: Footprint
    mass: Mass


class Ride:
    """Follows a route with one parcel for an order; `step` once a cycle while it is believed.

    `stopping` brings it to rest on its way for good. `obstructed` is whether something unknown
    keeps it from going on.
    """

    def __init__(
        self, order: Order, route: Route, load: Load, traction: Traction, grip: Grip | None = None
    ) -> None:
        self.order = order
        self.route = route
        self.stopping = False
        self.obstructed = False
        self.stands = False
        self._load = load
        self._traction = traction
        self._standstill = Standstill()
        path = Path(route.poses, load.footprint.reach_m)
        profile = traction.profile(path, load.footprint, load.mass)
        if self.leaves:
            profile = _driven_on(profile)
        self.follower = Follower(traction, profile, grip)
        self._behind_m = 0.0
        self.controller: GoalController | None = None

    @property
    def leaves(self) -> bool:
        """Whether the parcel is to leave the table."""
        return isinstance(self.order.goal, Gate)

    @property
    def progress_m(self) -> float:
        """The path coordinate that the parcel has come to, as is believed [m]."""
        return self.follower.reference.s_m - self._behind_m

    @property
    def at_rest(self) -> bool:
        """Whether it is commanded to stand."""
        return self.follower.reference.at_rest

    @property
    def off_path(self) -> bool:
        """Whether the parcel has left its way, or its goal, and is brought to rest."""
        controller, is_asked = self.controller, self.order.kept or not self.order.done
        has_left_goal = (
            controller is not None and not controller.feels and self._behind_m > _ASTRAY_M
        )
        return self.follower.off_path or (is_asked and has_left_goal)

    @property
    def has_come(self) -> bool:
        """Whether the way is done, and the parcel is brought to the goal itself, or held there."""
        return self.controller is not None and self.at_rest

    @property
    def may_feel(self) -> bool:
        """Whether the parcel may be moved in the next step to make its place sure."""
        return self.has_come and self.controller is not None and self.controller.may_feel

    @property
    def arrived(self) -> bool:
        """Whether the parcel is at its goal and has settled."""
        return self.controller is not None and self.controller.arrived

    @property
    def grip(self) -> Grip:
        """The estimate of the slip of its wheels."""
        return self.follower.grip if self.controller is None else self.controller.grip

    def has_left(self, belief: Belief | None, last: Floats) -> bool:
        """Whether it has left, given its present belief, and its last believed pose."""
        gate = self.order.goal
        if not isinstance(gate, Gate):
            return False
        out_m = gate.out_m(*last[:2].tolist())
        return belief is None and out_m > _NEARLY_OUT_M

    def step(
        self, belief: Belief, step_s: float, limit_m: float, moves: Sequence[Floats]
    ) -> Carried | None:
        """Motion of its wheels, with the way free up to `limit_m`; None: they stand.

        It may make one of these `moves` to be felt.
        """
        if self.controller is not None:
            return self._settle(self.controller, belief, step_s, moves)
        follower = self.follower
        follower.paused = belief.doubtful or self.stopping
        if limit_m > self.route.length_m - _SAME_M:
            # The path that is followed goes on beyond the edge where the parcel leaves; elsewhere
            # it has the same length as the route, but for rounding.
            limit_m = follower.profile.path.length_m
        carried = follower.step(belief, step_s, limit_m)
        self._look(belief)
        if follower.reference.at_rest:
            # It waits until the way is free.
            self._standstill.clear()
        elif not follower.paused:
            left_m = follower.profile.path.length_m - self.progress_m
            self.stands |= self._standstill.step(left_m, follower.reference.speed_m_s, step_s)
        length_m = follower.profile.path.length_m
        near = (
            self.order.kept and limit_m >= length_m and follower.reference.s_m > length_m - _LAST_M
        )
        if (follower.reference.finished or near) and not self.stopping:
            self._come()
        return carried

    def _settle(
        self,
        controller: GoalController,
        belief: Belief,
        step_s: float,
        moves: Sequence[Floats],
    ) -> Carried | None:
        controller.paused = belief.doubtful or self.stopping
        controller.feel = moves
        carried = controller.step(belief, step_s)
        self.order.moves = controller.moves
        self._look(belief)
        if controller.arrived or controller.settling:
            self._standstill.clear()
        elif not controller.paused:
            left_m, speed_m_s = controller.left_m, controller.speed_m_s
            self.stands |= self._standstill.step(left_m, speed_m_s, step_s, controller.leg)
        return carried

    def _look(self, belief: Belief) -> None:
        """Find how far the parcel is from its reference; others wait for it until it has come."""
        path = self.follower.profile.path
        off_m = path.distance_m(path.off(belief.pose, self.follower.reference.s_m))
        self._behind_m = 0.0 if self.arrived else off_m

    def _come(self) -> None:
        goal = self.order.goal
        if isinstance(goal, GoalPose):
            self.controller = GoalController(goal, self._traction, self._load.mass)
            self.controller.grip = self.follower.grip
            self.controller.moves = self.order.moves
            if self.order.kept:
                self.controller.go_on_with(self.follower)


def _driven_on(profile: SpeedProfile) -> SpeedProfile:
    """The profile of a way that ends at the table's edge, as if it went on beyond.

    The parcel is taken before it lacks wheels, and the plan beyond only keeps it going. At the edge
    itself it rests on wheels that may all push across its way: it coasts.
    """
    path = profile.path
    if not path.pieces:
        return profile
    onward = path.pieces[-1].direction * _ONWARD_M
    longer = Path(np.vstack(([*_corners(path)], [path.end + onward])), path.reach_m)
    bounds = profile.acceleration_m_s2.copy()
    weak = bounds < _WEAK_SHARE * np.median(bounds)
    last = len(bounds) - 1 - int(np.argmin(weak[::-1]))
    bounds[last + 1 :] = bounds[last]
    caps = profile.cap_m_s
    return replace(
        profile,
        path=longer,
        s_m=np.append(profile.s_m, longer.length_m),
        acceleration_m_s2=np.append(bounds, bounds[last]),
        cap_m_s=np.append(caps, caps[last]),
    )


def _corners(path: Path) -> Iterator[Floats]:
    yield path.start
    for piece in path.pieces:
        yield piece.pose_at(piece.end_s_m)
