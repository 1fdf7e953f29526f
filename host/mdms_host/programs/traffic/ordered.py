"""Many parcels on one table: orders become routes, and routes motion, none in another's way.

A parcel is planned for while it stands: one whose order changes on its way comes to rest first.
Those that move keep their routes, and the planner leads the others around them. From then on it is
the order over each tile that keeps parcels apart, and not the clock: how far each may go follows
from how far all have come.
"""

from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from math import hypot, inf
from types import MappingProxyType
from typing import Generic, TypeVar

from mdms_host.estimation.belief import Belief, Gain
from mdms_host.estimation.parcel import Parcel
from mdms_host.layout import Layout
from mdms_host.motion.goal import GoalPose
from mdms_host.motion.trajectory.pushes import Mass
from mdms_host.programs.order import Gate, Order
from mdms_host.programs.traffic.dispatch import Dispatch, NoWay, PlanExecutor, WayRules
from mdms_host.programs.traffic.ride import Load, Riding
from mdms_host.programs.traffic.world_state import Timetable, WorldState
from mdms_host.routes.grid import RIM_M, Tiles
from mdms_host.routes.planner import Margins, Planner, RoutePlan, SearchSettings
from mdms_host.routes.route import Pace, Route
from mdms_model.arrays import Floats

#: Tiles reach so far beyond the edge of the table where parcels may hang far over it [m].
_RIM_M = 0.15
#: There a parcel may also be so far off its way [m], where its wheels slip and as its belief is
#: off; a box with sides of 0.28 m does not tip so far off any.
_OFF_M = 0.006


def planner_of(
    layout: Layout,
    tiles: int,
    pace: Pace,
    settings: SearchSettings,
    *,
    clearance_m: float,
    gap_s: float,
    hangs: bool,
) -> Planner:
    """A planner on so many tiles along a cell's side; see `routes.planner.Margins`.

    Where it `hangs`, a parcel may hang over the edge of the table, as its goal does.
    """
    return Planner(
        Tiles(layout, tiles, _RIM_M if hangs else RIM_M),
        pace,
        Margins(clearance_m, gap_s, _OFF_M if hangs else 0.0),
        settings,
        hangs=hangs,
    )


#: A parcel that is not found for so long is lost to its order [s].
_LOST_S = 6.0
#: A parcel that has no way for so long, even if all others went, is refused one [s]. Nothing has
#: moved for so long when a way is given up before which something lies that may go away: a parcel,
#: or something unknown.
_IDLE_S = 1.0
_PATIENCE_S = 5.0
_UNKNOWN_S = 60.0
#: Blocked ways are looked at again so often [s].
_AGAIN_S = 0.25
#: A parcel that does not get on is tried so often, each time after so long [s], unless it has got
#: on by so much since the first time [m].
_TRIES = 5
_REST_S = 0.5
_GOT_ON_M = 0.05


@dataclass
class OrderedGoal:
    """A parcel that was ordered to a place: where to, and whether it is there."""

    goal: GoalPose
    arrived: bool = False


@dataclass
class _Stood:
    """How often a parcel has not got on with an order, where that was first, and when last."""

    order: Order
    place: Floats
    times: int
    last_s: float


Ride = TypeVar("Ride", bound=Riding)


class OrderedTraffic(ABC, Generic[Ride]):
    """Carries out orders for parcels, and keeps the parcels out of each other's way.

    Their loads are known, by name. Anything else that is believed to lie on the table is an
    obstacle. Parcels lie where they were `told` to until they are found.
    """

    def __init__(
        self,
        planner: Planner,
        executor: PlanExecutor,
        loads: Mapping[str, Load],
        rules: WayRules,
        *,
        told: Mapping[str, Floats] = MappingProxyType({}),
    ) -> None:
        self.steered: dict[str, OrderedGoal] = {}
        self._loads = loads = dict(loads)
        self._tiles = planner.tiles
        self._where = WorldState(loads, planner.stand, told)
        self._timetable = Timetable()
        self._dispatch = Dispatch(planner, executor, self._where, self._timetable, rules)
        self._now_s = 0.0
        self._orders: dict[str, Order] = {}
        #: The last order for each parcel: whoever waits at its end is told of the next one, too.
        self._last: dict[str, Order] = {}
        self._rides: dict[str, Ride] = {}
        self._again_s = 0.0
        self._moved_s = 0.0
        #: Since when parcels have had no way that nothing which moves can open [s].
        self._hopeless_s: dict[str, float] = {}
        #: Parcels that were reported to wait, and those that have not got on.
        self._waiting: set[str] = set()
        self._stood: dict[str, _Stood] = {}
        self._refused: set[str] = set()
        self._left: list[str] = []
        self._tracked: Callable[[], Collection[str]] = tuple
        #: Parcels that have set out to leave, on a way that may have been broken off.
        self._gone_out: set[str] = set()
        #: Parcels that have left, and are believed to be there a moment longer.
        self._lingering: set[str] = set()
        self._leaving: list[tuple[str, Gate | None]] = []
        self._notices: list[str] = []

    @abstractmethod
    def _set_out(self, order: Order, route: Route) -> Ride:
        """Begin to take a parcel along a route."""

    @abstractmethod
    def step(self, beliefs: Mapping[str, Belief], step_s: float) -> Floats:
        """References of all wheels (W,) [m/s] for the next cycle."""

    @property
    @abstractmethod
    def speeds_m_s(self) -> Floats:
        """How fast each wheel is to run under the references that were returned last, (W,)."""

    @property
    def gains(self) -> Mapping[str, Gain]:
        """Gains of the wheels under parcels in the step before these, as far as they are known."""
        return {}

    # Orders --------------------------------------------------------------------------------------

    def give(self, order: Order) -> None:
        """Take an order in place of any other for its parcel."""
        if not self._orders:
            # Nobody has waited on a table that was idle.
            self._moved_s = self._now_s
        before = self._last.get(order.parcel)
        if before is not None:
            before.replaced = True
        self._orders[order.parcel] = self._last[order.parcel] = order
        self._again_s = self._now_s
        # Why it had no way was of the order before.
        self._dispatch.blocked.pop(order.parcel, None)
        if isinstance(order.goal, GoalPose):
            self.steered[order.parcel] = OrderedGoal(order.goal)
        else:
            # A parcel that is to leave is away from its last goal because it was asked to be.
            self.steered.pop(order.parcel, None)
        if (ride := self._rides.get(order.parcel)) is not None:
            ride.stopping = True

    def cancel(self, order: Order) -> None:
        """Bring the parcel of an order to rest: nobody waits for it any more.

        A parcel that hangs over its exit by then leaves all the same.
        """
        name = order.parcel
        if self._orders.get(name) is not order or self._reaches_out(name, order):
            return
        order.replaced = True
        del self._orders[name]
        self.steered.pop(name, None)
        if (ride := self._rides.get(name)) is not None:
            ride.stopping = True

    def know(self, parcel: Parcel, mass: Mass) -> None:
        """There is to be another parcel."""
        self._loads[parcel.name] = Load(parcel.footprint, mass)

    def stop(self) -> None:
        """Bring all parcels to rest, and hold them there."""
        for order in self._orders.values():
            order.replaced = True
        self._orders.clear()
        for ride in self._rides.values():
            ride.stopping = True

    def on_lost_cells(self, cells: frozenset[int]) -> None:
        """These cells (from 1) are lost, and no others: ways lead around them, if any do.

        A parcel on its way to a newly lost cell comes to rest, and goes on by another way.
        """
        lost = self._dispatch.close(cells)
        for ride in self._rides.values():
            ride.stopping |= not ride.has_come and ride.route.meets(lost, ride.progress_m)

    def withdraw(self, name: str) -> None:
        """A parcel was never there: any order for it is done, and it is taken for one that left."""
        if name in self._rides:
            self._end_ride(name)
        self._remove(name)

    def forget(self, name: str) -> None:
        """Nobody asks for this parcel to be where it was ordered to any more."""
        self.steered.pop(name, None)

    def forget_refused(self) -> None:
        """A program goes on though these orders were refused: it asks for them no more."""
        for name in self._refused - self._orders.keys():
            self.forget(name)
        self._refused.clear()

    def attend(self, tracked: Callable[[], Collection[str]]) -> None:
        """From now on a parcel without a belief has left only if `tracked()` does not name it."""
        self._tracked = tracked

    def take_left(self) -> list[str]:
        """Parcels that have left the table since the last call."""
        left, self._left = self._left, []
        return left

    def take_leaving(self) -> list[tuple[str, Gate | None]]:
        """Parcels that have set out to leave since the last call, and through which gate.

        Without one, a parcel that was to leave has set out for another place.
        """
        leaving, self._leaving = self._leaving, []
        return leaving

    def take_notices(self) -> list[str]:
        """Notices for a person, since the last call."""
        notices, self._notices = self._notices, []
        return notices

    @property
    def at_rest(self) -> bool:
        """Whether all parcels are commanded to stand."""
        return all(ride.at_rest for ride in self._rides.values())

    @property
    @abstractmethod
    def near(self) -> Collection[str]:
        """Parcels that may be moved in the next step to make their places sure."""

    @property
    def plan(self) -> RoutePlan | None:
        """The plan that is in effect, for records and pictures."""
        return self._timetable.plan

    @property
    def under_way(self) -> Collection[str]:
        """Parcels that have a way before them."""
        return [name for name, ride in self._rides.items() if not ride.has_come]

    @property
    def ways(self) -> dict[str, Floats]:
        """The poses (K, 3) that are before each parcel under way, where it is now first."""
        return {
            name: ride.route.ahead(ride.progress_m, ride.route.length_m)
            for name, ride in self._rides.items()
            if not ride.has_come
        }

    @property
    def due_in_s(self) -> dict[str, Floats]:
        """In what time each parcel under way is planned at these poses [s], (K,)."""
        return {
            name: ride.route.ahead_s(ride.progress_m, ride.route.length_m) - self._now_s
            for name, ride in self._rides.items()
            if not ride.has_come
        }

    @property
    def reserved(self) -> list[tuple[float, float, float, tuple[str, ...]]]:
        """Tiles that parcels under way have before them, and which do, in their order.

        Middle and side of each [m; table frame].
        """
        visits: dict[int, list[tuple[float, str]]] = defaultdict(list)
        for name, ride in self._rides.items():
            left = ride.route.visits.leaves_m > ride.progress_m
            if not ride.has_come:
                columns = ride.route.visits.tile[left], ride.route.visits.enters_s[left]
                for tile, enters_s in zip(*(each.tolist() for each in columns), strict=True):
                    visits[tile].append((enters_s, name))
        return [
            (
                *self._tiles.centre_m(tile),
                self._tiles.side_m,
                tuple(dict.fromkeys(name for _, name in sorted(each))),
            )
            for tile, each in visits.items()
        ]

    # The cycle -----------------------------------------------------------------------------------

    def _advance(self, beliefs: Mapping[str, Belief], step_s: float) -> None:
        """Take in the beliefs, end finished rides, begin ready ones, and ask for more."""
        self._now_s += step_s
        self._where.see(beliefs, self._now_s)
        for name in self._lingering - beliefs.keys():
            self._where.drop(name)
        self._lingering &= beliefs.keys()
        self._where.find_obstacles(self._is_planned)
        self._settle(beliefs)
        self._begin()
        self._ask(beliefs)

    def _is_planned(self, name: str, place: Floats) -> bool:
        timetable = self._timetable
        return (
            name in self._rides
            or timetable.has_at(name, place)
            or timetable.leads_beside(name, place)
        )

    def _settle(self, beliefs: Mapping[str, Belief]) -> None:
        """End rides that have come to their end, and orders with them."""
        # A parcel that sensors do not show, and that is sought, may still lie before its exit.
        sure = {name for name, belief in beliefs.items() if not belief.doubtful}
        sought = set(self._tracked()) - sure
        for name, ride in list(self._rides.items()):
            order, belief = ride.order, beliefs.get(name)
            if name not in sought and ride.has_left(belief, self._where.places[name]):
                self._remove(name)
            elif ride.stands and not ride.stopping:
                self._stand(name, order)
                ride.stopping = True
            elif ride.arrived:
                order.done = True
                if self._orders.get(name) is order and not order.kept:
                    del self._orders[name]
                # A parcel that has been ordered elsewhere since is not there yet.
                if name in self.steered and self.steered[name].goal is order.goal:
                    self.steered[name].arrived = True
            elif name in self.steered:
                self.steered[name].arrived = False
            # A parcel that needs another way begins it at rest.
            away = belief is None or ride.off_path or (ride.obstructed and not ride.arrived)
            if (ride.stopping or away) and ride.at_rest and name in self._rides:
                self._end_ride(name)
        for name, order in list(self._orders.items()):
            gone = name not in beliefs and name not in sought
            if gone and self._reaches_out(name, order):
                self._remove(name)
            elif not order.kept and self._now_s - self._where.seen_s(name) > _LOST_S:
                self._refuse(name, f"{name} is lost: no sensor has shown it for {_LOST_S:g} s")

    def _reaches_out(self, name: str, order: Order) -> bool:
        """Whether a parcel that is to leave was last where it hangs over its exit."""
        gate, place = order.goal, self._where.places.get(name)
        if not isinstance(gate, Gate) or place is None or name not in self._gone_out:
            return False
        corners_m = self._loads[name].footprint.outline_m(place)
        return any(gate.out_m(*corner) > 0.0 for corner in corners_m.tolist())

    def _stand(self, name: str, order: Order) -> None:
        """A parcel does not get on: it is tried again from where it stands, some times."""
        place, stood = self._where.places[name], self._stood.get(name)
        got_on = stood is not None and hypot(*(place - stood.place)[:2].tolist()) > _GOT_ON_M
        if stood is None or got_on or stood.order is not order:
            stood = self._stood[name] = _Stood(order, place.copy(), 0, 0.0)
        stood.times, stood.last_s = stood.times + 1, self._now_s
        text, goal = f"{name} does not get on", order.goal
        if isinstance(goal, GoalPose):
            left_m = hypot(goal.x_m - place[0], goal.y_m - place[1])
            text += f", {1e3 * left_m:.0f} mm from its goal"
        if stood.times == _TRIES:
            self._refuse(name, f"{text}, tried {_TRIES} times: stopped")
        elif stood.times == 1:
            self._notices.append(f"{text}: it is tried again")

    def _end_ride(self, name: str) -> None:
        """A parcel goes no further on its route."""
        del self._rides[name]
        if name in self._orders and name in self.steered:
            self.steered[name].arrived = False

    def _remove(self, name: str) -> None:
        """A parcel has left the table."""
        ride, order = self._rides.pop(name, None), self._orders.pop(name, None)
        if ride is not None:
            ride.order.done = True
        if order is not None and (ride is None or order is ride.order):
            order.done = True
        elif order is not None:
            # It came too late. The next parcel may have the same name.
            order.refused = f"{name} has left the table"
        self.steered.pop(name, None)
        self._last.pop(name, None)
        self._stood.pop(name, None)
        self._gone_out.discard(name)
        self._where.drop(name)
        self._timetable.leave(name)
        self._left.append(name)
        self._lingering.add(name)
        self._again_s = self._now_s

    def _refuse(self, name: str, reason: str) -> None:
        order = self._orders.pop(name, None)
        if order is not None:
            order.refused = reason
            if not order.kept:
                self._refused.add(name)

    # Plans

    def _begin(self) -> None:
        """Set out on a plan that is ready, with all parcels that are as it was made for."""
        before = self._timetable.plan
        for order, route in self._dispatch.take():
            self._rides[order.parcel] = self._set_out(order, route)
            if isinstance(order.goal, Gate):
                self._leaving.append((order.parcel, order.goal))
                self._gone_out.add(order.parcel)
            elif order.parcel in self._gone_out:
                self._leaving.append((order.parcel, None))
                self._gone_out.discard(order.parcel)
        if self._timetable.plan is not before:
            self._again_s = self._now_s + _AGAIN_S

    def _ask(self, beliefs: Mapping[str, Belief]) -> None:
        """Have a plan made for those that stand and are to go somewhere."""
        wanting = {
            name: order
            for name, order in self._orders.items()
            if name in beliefs and not beliefs[name].doubtful and self._is_standing(name)
        }
        if not wanting or self._dispatch.is_busy or self._now_s < self._again_s:
            return
        if self._give_up(wanting):
            return
        riding_m = {
            name: ride.progress_m for name, ride in self._rides.items() if not ride.has_come
        }
        self._dispatch.ask(wanting, riding_m, self._now_s)

    def _give_up(self, wanting: Collection[str]) -> bool:
        """Refuse those without a way that have waited long enough; whether any.

        Those that something bars wait for all others to stand.
        """
        blocked, idle_s = self._dispatch.blocked, self._now_s - self._moved_s
        self._waiting &= blocked.keys()
        self._hopeless_s = {
            name: self._hopeless_s.get(name, self._now_s)
            for name, one in blocked.items()
            if not one.may_pass
        }
        all_stand = blocked.keys() >= set(wanting) and idle_s > _IDLE_S
        over = [
            name
            for name, one in blocked.items()
            if (all_stand and idle_s > _patience_s(one))
            or self._now_s > self._hopeless_s.get(name, inf) + _IDLE_S
        ]
        for name in over:
            self._refuse(name, blocked.pop(name).text)
        if not all_stand:
            return bool(over)
        for name in blocked.keys() - self._waiting:
            limit_s, text = _patience_s(blocked[name]), blocked[name].text
            self._notices.append(f"{name} waits, for {limit_s:g} s at most: {text}")
        self._waiting |= blocked.keys()
        return bool(over)

    def _is_standing(self, name: str) -> bool:
        stood = self._stood.get(name)
        if stood is not None and self._now_s < stood.last_s + _REST_S:
            return False
        ride = self._rides.get(name)
        if ride is None:
            return True
        if ride.has_come and ride.order is not self._orders.get(name):
            del self._rides[name]
            return True
        return False

    # Motion

    def _under_way(
        self, beliefs: Mapping[str, Belief]
    ) -> Iterator[tuple[str, Ride, Belief, float]]:
        """Each ride of a parcel that is believed, and up to where its route is free [m]."""
        timetable, there = self._timetable, self._where.places
        timetable.progress_m.update((name, ride.progress_m) for name, ride in self._rides.items())
        limits_m = timetable.limits_m(there)
        going = self._orders.keys() - self._dispatch.blocked.keys()
        held = timetable.held(there, self._rides, going)
        for name, ride in self._rides.items():
            belief = beliefs.get(name)
            if belief is not None:
                free_m = self._where.free_m(name, ride.route, ride.progress_m)
                ride.obstructed = free_m < ride.route.length_m or name in held
                yield name, ride, belief, min(limits_m.get(name, inf), free_m)


def _patience_s(no_way: NoWay) -> float:
    """How long a parcel waits that has no way, while nothing moves [s]."""
    if not no_way.may_pass:
        return _IDLE_S
    return _UNKNOWN_S if no_way.by_unknown else _PATIENCE_S
