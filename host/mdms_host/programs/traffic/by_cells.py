"""Traffic of parcels that cells steer: each route is sent leg by leg, as goals.

The host sends the order of parcels over each cell, too."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from math import inf

import numpy as np

from mdms_host.estimation.belief import Belief
from mdms_host.estimation.footprint import Disc
from mdms_host.estimation.parcel import Parcel
from mdms_host.layout import Layout
from mdms_host.motion.by_cells.followed import Followed
from mdms_host.motion.by_cells.program import CellsProgram
from mdms_host.motion.by_cells.sending import CellsMotion, CellTurn
from mdms_host.motion.goal import GoalPose
from mdms_host.motion.trajectory.path import Path
from mdms_host.motion.trajectory.pushes import Mass
from mdms_host.programs.order import Order
from mdms_host.programs.traffic.dispatch import PlanExecutor, WayRules
from mdms_host.programs.traffic.ordered import OrderedTraffic, planner_of
from mdms_host.programs.traffic.ride import Load
from mdms_host.routes.grid import Tiles
from mdms_host.routes.planner import SearchSettings
from mdms_host.routes.reservations import Reservations, Visit
from mdms_host.routes.route import Route, TrapezoidPace
from mdms_model.arrays import Floats
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours.frames import LEGS_MAX

#: A parcel is at a corner of its route, from where the next leg begins, within this [m].
_CORNER_M = 0.008
#: A leg is sent in parts as the way becomes free, if a part is so much longer than the last [m].
_PART_M = 0.05
#: A parcel that is farther beside its route has left it [m].
_OFF_PATH_M = 0.03
#: How far back and ahead of where it was a parcel is looked for on its route [m].
_SEARCH_M = 0.1
#: Path coordinates that differ by less are the same [m].
_SAME_M = 0.002
#: It stands once it has been slower for so long [m/s; s].
_STILL_M_S = 0.004
_STILL_S = 0.25

#: Has the cells take a parcel to a goal, and, should the host be gone by then, along the legs that
#: follow; whether the goal is the last; returns the follower to the goal.
Send = Callable[[GoalPose, Sequence[GoalPose], bool], Followed]


class Legs:
    """Takes a parcel along a route for an order; see `ride.Riding`. `step` once a cycle.

    A leg is straight, and ends at a corner, amid a half turn, or where the way is not free yet.
    Cells drive straight at the place that was sent last. If they go on without the host, the legs
    that follow are sent for that time. They are not sent if the parcel is to stop or something is
    in its way.
    """

    def __init__(
        self, order: Order, route: Route, load: Load, send: Send, motion: CellsMotion
    ) -> None:
        self.order = order
        self.route = route
        self.stopping = False
        self.obstructed = False
        self.off_path = False
        self.progress_m = 0.0
        self._is_round = isinstance(load.footprint, Disc)
        self._path = Path(route.poses, load.footprint.reach_m)
        self._send = send
        self._acceleration_m_s2 = motion.limits.acceleration_m_s2
        self._goes_on = motion.go_on
        self._sent_m = 0.0
        self._leads_on = False
        self._passed_m = 0.0
        self._followed: Followed | None = None
        self._still_s = 0.0

    @property
    def at_rest(self) -> bool:
        """Whether it has stood for a while."""
        return self._still_s >= _STILL_S

    @property
    def stands(self) -> bool:
        """Whether it did not move as its cells commanded, and was stopped."""
        return self._followed is not None and self._followed.stopped

    @property
    def has_come(self) -> bool:
        """Whether nothing but its goal is left to be sent, and it is about to be there."""
        end_m = self._path.length_m
        sent = self._followed is not None and self._sent_m >= end_m
        return sent and self.progress_m >= end_m - _CORNER_M

    @property
    def given_m(self) -> float:
        """Up to where its cells would take it, were the host gone."""
        if not self._leads_on:
            return self._sent_m
        ends_m = [end_m for end_m in self._path.legs_m if end_m > self._sent_m + _SAME_M]
        return max(ends_m[:LEGS_MAX], default=self._sent_m)

    @property
    def arrived(self) -> bool:
        """Whether its cells report it at its goal, and it is believed there."""
        return self.has_come and self._followed is not None and self._followed.arrived

    def has_left(self, belief: Belief | None, last: Floats) -> bool:
        """Never: cells keep parcels on the table."""
        return False

    def step(self, belief: Belief, step_s: float, limit_m: float) -> None:
        """Take in where the parcel is, and send the goal that follows, if another does.

        The way is free up to `limit_m`.
        """
        self._look(belief, step_s)
        if self._is_felt:
            if self.stopping:
                self._followed = self._send(self._goal_here(belief), [], False)
        elif not self.stands:
            self._go(self._to_m(belief, limit_m))

    @property
    def _is_felt(self) -> bool:
        """Whether it is moved away from its goal to make its place sure."""
        followed = self._followed
        return followed is not None and followed.place != followed.goal

    def _look(self, belief: Belief, step_s: float) -> None:
        """Find the parcel on its route; a corner that it has come to is behind it."""
        path = self._path
        slow = path.distance_m(belief.twist) < _STILL_M_S
        self._still_s = self._still_s + step_s if slow else 0.0
        if self._is_felt:
            return
        if self._followed is not None and self._followed.overtaken:
            # Without a host for a moment, its cells have gone on to the next corner by themselves.
            self._followed.overtaken = False
            self._passed_m, self._sent_m = self._sent_m, self._corner_after_m(self._sent_m)
            self._leads_on = self._may_lead_on(self._sent_m)
        low_m = max(self._passed_m, self.progress_m - _SEARCH_M)
        nearest_m = path.nearest_m(belief.pose, low_m, self._sent_m)
        off_m = path.distance_m(path.off(belief.pose, nearest_m))
        self.off_path = off_m > _OFF_PATH_M
        there = self._followed is not None and self._followed.arrived
        if there or nearest_m - off_m >= self._sent_m - _CORNER_M:
            self._passed_m = self._sent_m
        self.progress_m = max(self._passed_m, nearest_m - off_m)

    def _to_m(self, belief: Belief, limit_m: float) -> float:
        """Up to where the cells are to take it now, and no less than where it can stop."""
        path = self._path
        speed_m_s = path.distance_m(belief.twist)
        stop_m = self.progress_m + speed_m_s**2 / (2 * self._acceleration_m_s2)
        if self.stopping or self.off_path:
            return min(self._sent_m, stop_m)
        corner_m = self._corner_after_m(self._passed_m)
        # A way that is free has the same length as the path, but for rounding.
        free_m = corner_m if limit_m > corner_m - _SAME_M else limit_m
        return max(free_m, min(self._sent_m, stop_m))

    def _corner_after_m(self, along_m: float) -> float:
        ahead = (end_m for end_m in self._path.legs_m if end_m > along_m)
        return next(ahead, self._path.length_m)

    def _go(self, to_m: float) -> None:
        """Send a goal, if it is worth the frames; or the same once more if legs may not follow."""
        farther_m = to_m - self._sent_m
        ends = to_m in self._path.legs_m or self._passed_m >= self._sent_m
        same = -_SAME_M <= farther_m <= (_SAME_M if ends else _PART_M)
        leads_on = self._may_lead_on(self._sent_m if same else to_m)
        if same and self._followed is None and to_m < self._path.length_m:
            return
        if same and self._followed is not None and leads_on == self._leads_on:
            return
        if not same:
            self._sent_m = to_m
        self._leads_on = leads_on
        legs = [*self._legs_after(self._sent_m)] if leads_on else []
        last = self._sent_m >= self._path.length_m
        self._followed = self._send(self._goal_at(self._sent_m), legs, last)

    def _may_lead_on(self, sent_m: float) -> bool:
        """Whether cells without a host are to go on after a goal."""
        clear = not (self.stopping or self.off_path or self.obstructed)
        return self._goes_on and clear and sent_m < self._path.length_m - _SAME_M

    def _legs_after(self, sent_m: float) -> Iterator[GoalPose]:
        """The corners behind a goal, and the end."""
        return (self._goal_at(end_m) for end_m in self._path.legs_m if end_m > sent_m + _SAME_M)

    def _goal_here(self, belief: Belief) -> GoalPose:
        """A goal at which it stops from any place: cells bring it back to where it is now."""
        x_m, y_m, yaw_rad = belief.pose.tolist()
        return GoalPose(x_m, y_m, None if self._is_round else yaw_rad)

    def _goal_at(self, to_m: float) -> GoalPose:
        goal = self.order.goal
        if to_m >= self._path.length_m and isinstance(goal, GoalPose):
            return goal
        x_m, y_m, yaw_rad = self._path.pose_at(to_m).tolist()
        return GoalPose(x_m, y_m, None if self._is_round else yaw_rad)


#: A parcel that comes over the same cell again comes twice, if it is planned to be away for longer
#: between [s]. Cells wait twice as long for one that stays beside them: it may be slower by then.
_AWAY_S = 2.5


def turns_over_cells(
    reservations: Reservations,
    tiles: Tiles,
    come_m: Mapping[str, float],
    until_m: Mapping[str, float],
) -> dict[int, tuple[CellTurn, ...]]:
    """The turns of parcels over each cell (from 1) that more than one of them is yet to come over.

    Each goes from `come_m` of its route to `until_m`; parcels that are not listed come nowhere.
    Tiles are as large as cells.
    """
    turns_over = {}
    for tile, visits in reservations.order.items():
        turns = _turns([visit for visit in visits if _is_ahead(visit, come_m, until_m)])
        cell = tiles.cell_of(tile)
        if cell is not None and len({turn.parcel for turn in turns}) > 1:
            turns_over[cell] = turns
    return turns_over


def _is_ahead(visit: Visit, come_m: Mapping[str, float], until_m: Mapping[str, float]) -> bool:
    name = visit.parcel
    return visit.leaves_m > come_m.get(name, inf) and visit.enters_m < until_m[name]


def _turns(visits: list[Visit]) -> tuple[CellTurn, ...]:
    turns: list[CellTurn] = []
    left_s = -inf
    for visit in visits:
        if not turns or visit.parcel != turns[-1].parcel or visit.enters_s > left_s + _AWAY_S:
            turns.append(CellTurn(visit.parcel, visit.enters_m))
        left_s = visit.leaves_s
    return tuple(turns)


#: A cell is promised to one parcel at a time, so that tiles are no smaller than cells.
_TILES = 1
#: A parcel asks for the cells that it reaches before it can stand: some mm beyond where it is to,
#: and 4 mm around it.
_CLEARANCE_M = 0.01
_GAP_S = 0.2
#: The turns of parcels over each cell are made anew so often [s].
_TURNS_S = 0.1
#: Cells are given a whole way of so many legs, even while the first is gone along in parts.
_LEGS = wire.LEGS_MAX


class CellsTraffic(OrderedTraffic[Legs]):
    """Traffic by way of `cells`, which steer the parcels; see `OrderedTraffic`."""

    def __init__(
        self,
        layout: Layout,
        executor: PlanExecutor,
        loads: Mapping[str, Load],
        cells: CellsProgram,
        *,
        hangs: bool = False,
    ) -> None:
        limits = cells.motion.limits
        planner = planner_of(
            layout,
            _TILES,
            TrapezoidPace(limits.speed_m_s, limits.acceleration_m_s2),
            SearchSettings(legs=_LEGS),
            clearance_m=_CLEARANCE_M,
            gap_s=_GAP_S,
            hangs=hangs,
        )
        # A parcel that goes on without the host crosses no lost cell; see `by_cells.lost_cells`.
        rules = WayRules(over_lost=not cells.motion.go_on, beside=False)
        super().__init__(planner, executor, loads, rules)
        self.cells = cells
        self._turns_due_s = -inf
        self._still: Floats = np.zeros(len(layout.wheel_cells))

    def know(self, parcel: Parcel, mass: Mass) -> None:
        """There is to be another parcel."""
        super().know(parcel, mass)
        self.cells.add(parcel)

    def on_lost_cells(self, cells: frozenset[int]) -> None:
        """See `OrderedTraffic`."""
        self.cells.on_lost_cells(cells)
        super().on_lost_cells(cells)

    def begin_again(self) -> None:
        """The cells' programs have ended; without the host they may have been on any leg by then.

        Parcels on their way are planned anew from where they lie.
        """
        for name in [name for name, ride in self._rides.items() if not ride.has_come]:
            self._end_ride(name)
        self.cells.begin_again()

    def take_notices(self) -> list[str]:
        """See `OrderedTraffic`."""
        return super().take_notices() + self.cells.take_notices()

    def step(self, beliefs: Mapping[str, Belief], step_s: float) -> Floats:
        """References of all wheels (W,): 0, for the host commands none."""
        for name in self._rides.keys() - beliefs.keys():
            # A parcel that is not found is not steered, and planned anew where it is found.
            self._end_ride(name)
        self._advance(beliefs, step_s)
        for _, ride, belief, limit_m in self._under_way(beliefs):
            ride.step(belief, step_s, limit_m)
            if not ride.at_rest:
                self._moved_s = self._now_s
        if self.cells.motion.go_on:
            self._set_turns()
        return self._still

    def doubt_arrivals(self) -> None:
        """No parcel has arrived that the beliefs of this cycle do not show at its goal any more."""
        for name, ride in self._rides.items():
            if name in self.steered and not ride.arrived:
                self.steered[name].arrived = False

    @property
    def near(self) -> Collection[str]:
        """See `OrderedTraffic`."""
        return self.cells.near

    @property
    def speeds_m_s(self) -> Floats:
        """How fast each wheel is to run, (W,): what cells command is not known."""
        return self._still

    def _set_turns(self) -> None:
        """Have cells get the turns over them, of parcels as far as these would go by themselves."""
        if self.plan is None or self._now_s < self._turns_due_s:
            return
        self._turns_due_s = self._now_s + _TURNS_S
        come_m = {name: ride.progress_m for name, ride in self._rides.items()}
        until_m = {name: ride.given_m for name, ride in self._rides.items()}
        reservations = self.plan.reservations
        self.cells.set_turns(turns_over_cells(reservations, self._tiles, come_m, until_m))

    def _set_out(self, order: Order, route: Route) -> Legs:
        def send(goal: GoalPose, legs: Sequence[GoalPose], last: bool) -> Followed:
            return self.cells.lead(order.parcel, goal, legs, last=last)

        return Legs(order, route, self._loads[order.parcel], send, self.cells.motion)

    def _end_ride(self, name: str) -> None:
        super()._end_ride(name)
        self.cells.end(name)
