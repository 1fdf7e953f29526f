"""Many parcels on one table: orders become routes, and routes motion, none in another's way.

A parcel is planned for while it stands: one whose order changes on its way comes to rest first.
Those that move keep their routes, and the planner leads the others around them. From then on it is
the order over each tile that keeps parcels apart, and not the clock: how far each may go follows
from how far all have come.
"""

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import hypot, inf

import numpy as np

from mdms_host.estimation.belief import Belief
from mdms_host.estimation.outlines.bottom import Bottom
from mdms_host.motion.carrying import Carrying
from mdms_host.motion.goal import Goal
from mdms_host.motion.trajectory.follower import Carried
from mdms_host.motion.trajectory.grip import Grip
from mdms_host.motion.trajectory.traction import Traction
from mdms_host.programs.order import Gate, Order
from mdms_host.programs.planning import Desk
from mdms_host.programs.ride import Load, Ride
from mdms_host.routes.errand import Task
from mdms_host.routes.pace import Pace
from mdms_host.routes.planner import Plan, Planner
from mdms_host.routes.route import Route
from mdms_host.routes.space.shape import Shape
from mdms_host.routes.space.tiles import Tiles
from mdms_model.arrays import Bools, Floats, Ints

#: A parcel that leaves is taken so soon after it has come to the end of its route [s].
_LEAVES_S = 0.3
#: How far beyond the last support its route ends [m]: before it, for it has wheels there.
_OUT_M = -0.01
#: A parcel that is not found for so long is lost to its order [s].
_LOST_S = 3.0
#: Nothing has moved for so long when a way that is blocked is given up [s].
_IDLE_S = 1.0
#: Blocked ways are looked at again so often [s].
_AGAIN_S = 0.25
#: Tiles along a cell's side: the finer, the nearer parcels may pass each other. Places that ways
#: lead over are so many tiles apart.
_TILES, _STEP = 4, 2
#: Outlines are planned so much larger on all sides [m], and so much apart in time [s].
_CLEARANCE_M = 0.008
_GAP_S = 0.1
#: What stands farther from where the plan has it is in the way of others [m].
_ASTRAY_M = 0.03
#: A parcel stops so far before an obstacle's tiles, for it is to find a way from there [m].
_SHORT_M = 0.01
#: An obstacle that has moved by less is where it was [m, m, rad].
_SAME = 2e-3
#: A move that is planned for practice [m], with so little of a turn [rad].
_LITTLE_M, _LITTLE_RAD = 0.1, 0.01
#: Room that a parcel needs around it to turn on the spot [m].
_NEAR_M = 0.015


@dataclass
class Steered:
    """A parcel that was ordered to a place: where to, and whether it is there."""

    goal: Goal
    arrived: bool = False


@dataclass(frozen=True, slots=True)
class Obstacle:
    """Something that lies where the plan has nothing: its place, and the tiles under it."""

    place: Floats
    shape: Shape
    tiles: Ints


@dataclass(frozen=True, slots=True)
class KeptFree:
    """A place that is kept free by all that does not lie there, as if something of a shape did."""

    name: str
    pose: Floats
    shape: Shape


class TableTraffic:
    """Carries out orders for parcels whose loads are known, by name; see `program.Traffic`.

    Anything else that is believed to lie on the table is an obstacle. Places of `kept_free` are not
    crossed: somebody may set a parcel down there at any time.
    """

    def __init__(
        self,
        traction: Traction,
        pace: Pace,
        desk: Desk,
        loads: Mapping[str, Load],
        *,
        kept_free: Sequence[KeptFree] = (),
    ) -> None:
        self.steered: dict[str, Steered] = {}
        self._traction = traction
        self._planner = Planner(
            Tiles(traction.layout, _TILES), pace, clearance_m=_CLEARANCE_M, step=_STEP, gap_s=_GAP_S
        )
        tiles = self._planner.tiles
        self._closed: Bools = np.zeros(tiles.count, dtype=bool)
        self._obstacles: dict[str, Obstacle] = {}
        self._desk = desk
        self._loads = loads
        self._kept_free_places = kept_free
        self._carrying = Carrying(traction.layout, traction.drives)
        self._shapes = {name: _shape_of(load) for name, load in loads.items()}
        self._now_s = 0.0
        self._orders: dict[str, Order] = {}
        self._rides: dict[str, Ride] = {}
        self._grips: dict[str, Grip] = {}
        self._plan: Plan | None = None
        #: Who was asked for in the plan that is being made, by order.
        self._asked: dict[str, Order] = {}
        #: Who has left since the plan was asked for, and since the next one was: another parcel may
        #: have come under the same name.
        self._gone: set[str] = set()
        self._gone_since: set[str] = set()
        #: How far all have come on their routes of the plan; 0 where that is not listed.
        self._progress_m: dict[str, float] = {}
        #: Who waits for one that stays where it is, by who rides and who stays.
        self._held: frozenset[str] = frozenset()
        self._held_by: tuple[frozenset[str], frozenset[str]] | None = None
        self._places: dict[str, Floats] = {}
        self._seen_s: dict[str, float] = {}
        self._blocked: dict[str, str] = {}
        self._again_s = 0.0
        self._moved_s = 0.0
        self._left: list[str] = []
        self._leaving: list[tuple[str, Gate]] = []
        self._notices: list[str] = []
        if desk.real_time:
            self._prepare()

    def _prepare(self) -> None:
        """Have the planner work out once what it needs for every kind of parcel."""
        for shape in set(self._shapes.values()):
            for yaw_rad in (_LITTLE_RAD, -_LITTLE_RAD):
                start, goal = np.array([0.0, 0.0, yaw_rad]), np.array([_LITTLE_M, 0.0, yaw_rad])
                self._planner.plan([Task("any", shape, start[None, :], goal)])

    # Orders --------------------------------------------------------------------------------------

    def give(self, order: Order) -> None:
        """Take an order in place of any other for its parcel."""
        before = self._orders.get(order.parcel)
        if before is not None:
            before.replaced = True
        self._orders[order.parcel] = order
        self._again_s = self._now_s
        if isinstance(order.goal, Goal):
            self.steered[order.parcel] = Steered(order.goal)
        if (ride := self._rides.get(order.parcel)) is not None:
            ride.stopping = True

    def stop(self) -> None:
        """Bring all parcels to rest, and hold them there."""
        for order in self._orders.values():
            order.replaced = True
        self._orders.clear()
        for ride in self._rides.values():
            ride.stopping = True

    def on_lost_cells(self, cells: frozenset[int]) -> None:
        """These cells (from 1) are lost: ways lead around them, where there are any."""
        self._closed[:] = False
        for cell in cells:
            self._closed[self._planner.tiles.of_cell(cell)] = True

    def take_left(self) -> list[str]:
        """Parcels that have left the table since the last call."""
        left, self._left = self._left, []
        return left

    def take_leaving(self) -> list[tuple[str, Gate]]:
        """Parcels that have set out to leave since the last call, and through which gate."""
        leaving, self._leaving = self._leaving, []
        return leaving

    def take_notices(self) -> list[str]:
        """What a person should learn, since the last call."""
        notices, self._notices = self._notices, []
        return notices

    @property
    def near(self) -> Collection[str]:
        """Parcels about to arrive."""
        return [name for name, ride in self._rides.items() if ride.has_come]

    @property
    def plan(self) -> Plan | None:
        """The plan that is in effect, for records and pictures."""
        return self._plan

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
        """In what time each parcel is planned at the poses of its way [s], (K,)."""
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
        tiles = self._planner.tiles
        return [
            (
                *tiles.centre_m(tile),
                tiles.side_m,
                tuple(dict.fromkeys(name for _, name in sorted(each))),
            )
            for tile, each in visits.items()
        ]

    # The cycle -----------------------------------------------------------------------------------

    def step(self, beliefs: Mapping[str, Belief], step_s: float) -> Floats:
        """References of all wheels (W,) [m/s] for the next cycle."""
        self._now_s += step_s
        self._look(beliefs)
        self._find_obstacles(beliefs)
        self._settle(beliefs)
        self._begin()
        self._ask(beliefs)
        carried = dict(self._drive(beliefs, step_s))
        if carried:
            self._moved_s = self._now_s
        outlines = {name: self._outline(name, beliefs) for name in self._places}
        return self._carrying.references_m_s(carried, outlines, self._places)

    @property
    def speeds_m_s(self) -> Floats:
        """How fast each wheel is to run under the references that were returned last, (W,)."""
        return self._carrying.speeds_m_s

    def _look(self, beliefs: Mapping[str, Belief]) -> None:
        """Where everything is, and was last; what is unknown lies where it is seen only."""
        self._places = {
            name: place for name, place in self._places.items() if name in self._loads
        } | {name: belief.pose for name, belief in beliefs.items()}
        for name in beliefs:
            self._seen_s[name] = self._now_s

    def _find_obstacles(self, beliefs: Mapping[str, Belief]) -> None:
        """Find what lies where the plan has nothing, by the tiles under it."""
        kept, self._obstacles = self._obstacles, {}
        for name, place in self._places.items():
            if name in self._rides or self._is_as_planned(name, place):
                continue
            before = kept.get(name)
            if before is not None and np.abs(before.place - place).max() < _SAME:
                self._obstacles[name] = before
            elif (shape := self._shape(name, beliefs)) is not None:
                self._obstacles[name] = Obstacle(place, shape, self._planner.stand(shape, place))

    def _is_as_planned(self, name: str, place: Floats) -> bool:
        """Whether something stands where the plan has it."""
        if self._plan is None or name in self._gone or name not in self._plan.routes:
            return False
        planned = self._plan.routes[name].pose_at(self._progress_m.get(name, 0.0))
        return bool(hypot(*(planned - place)[:2].tolist()) < _ASTRAY_M)

    def _shape(self, name: str, beliefs: Mapping[str, Belief]) -> Shape | None:
        """The shape of a parcel, or of something unknown as far as it may reach."""
        if name in self._shapes or name not in beliefs:
            return self._shapes.get(name)
        return Shape(beliefs[name].outline)

    def _settle(self, beliefs: Mapping[str, Belief]) -> None:
        """End rides that have come to their end, and orders with them."""
        for name, ride in list(self._rides.items()):
            order, belief = ride.order, beliefs.get(name)
            if ride.has_left(belief, self._places[name]):
                self._remove(name)
            elif ride.stands and not ride.stopping:
                self._refuse(name, f"{name} does not get on: stopped")
                ride.stopping = True
            elif ride.arrived:
                self.steered[name].arrived = True
                order.done = True
                if self._orders.get(name) is order:
                    del self._orders[name]
            elif name in self.steered:
                self.steered[name].arrived = False
            # Whoever has to find another way begins it at rest.
            away = belief is None or ride.follower.off_path or ride.obstructed
            if (ride.stopping or away) and ride.at_rest and name in self._rides:
                del self._rides[name]
        for name in list(self._orders):
            if self._now_s - self._seen_s.get(name, 0.0) > _LOST_S:
                self._refuse(name, f"{name} is lost: no sensor shows it")

    def _remove(self, name: str) -> None:
        """A parcel has left the table."""
        ride = self._rides.pop(name)
        ride.order.done = True
        if self._orders.get(name) is ride.order:
            del self._orders[name]
        for kept in (self._places, self._seen_s, self._grips, self.steered, self._blocked):
            kept.pop(name, None)
        self._left.append(name)
        self._gone.add(name)
        self._gone_since.add(name)
        self._again_s = self._now_s

    def _refuse(self, name: str, reason: str) -> None:
        order = self._orders.pop(name, None)
        if order is not None:
            order.refused = reason

    # Plans

    def _begin(self) -> None:
        """Set out on a plan that is ready, with all parcels that are as it was made for."""
        plan = self._desk.take()
        if plan is None:
            return
        self._plan = plan
        self._held_by = None
        self._progress_m = {}
        self._gone = set(self._gone_since)
        self._blocked = {}
        for name, order in self._asked.items():
            if self._orders.get(name) is not order or name in self._rides:
                continue
            if name in plan.blocked:
                self._blocked[name] = str(plan.blocked[name])
                continue
            grip = self._grips.setdefault(name, Grip())
            route = plan.routes[name]
            self._rides[name] = Ride(order, route, self._loads[name], self._traction, grip)
            if isinstance(order.goal, Gate):
                self._leaving.append((name, order.goal))
        self._asked = {}
        self._again_s = self._now_s + _AGAIN_S

    def _ask(self, beliefs: Mapping[str, Belief]) -> None:
        """Have a plan made for those that stand and are to go somewhere."""
        wanting = {
            name: order
            for name, order in self._orders.items()
            if name in beliefs and not beliefs[name].doubtful and self._is_standing(name)
        }
        if not wanting or self._desk.is_busy or self._now_s < self._again_s:
            return
        if wanting.keys() <= self._blocked.keys() and self._now_s - self._moved_s > _IDLE_S:
            for name, reason in self._blocked.items():
                self._refuse(name, reason)
            self._blocked = {}
            return
        self._asked = wanting
        self._gone_since.clear()
        tasks, kept = self._tasks(beliefs), self._kept()
        self._desk.ask(partial(self._planned, tasks, self._now_s, kept, self._closed.copy()))

    def _planned(
        self, tasks: list[Task], now_s: float, kept: dict[str, Route], closed: Bools
    ) -> Plan:
        """A plan around closed tiles, or over them if there is no other way for somebody."""
        plan = self._planner.plan(tasks, now_s, closed=closed, kept=kept)
        if plan.blocked and closed.any():
            return self._planner.plan(tasks, now_s, kept=kept)
        return plan

    def _is_standing(self, name: str) -> bool:
        ride = self._rides.get(name)
        if ride is None:
            return True
        if ride.has_come and ride.order is not self._orders.get(name):
            del self._rides[name]
            return True
        return False

    def _tasks(self, beliefs: Mapping[str, Belief]) -> list[Task]:
        """All that stands, with the goal of those that are to go somewhere."""
        tasks = []
        for name, pose in self._places.items():
            if name in self._rides and not self._rides[name].has_come:
                continue
            shape = self._shape(name, beliefs)
            if shape is None:
                continue
            goal, leaves = self._goal(name, pose)
            ahead = np.array([pose])
            tasks.append(Task(name, shape, ahead, goal, leaves, _LEAVES_S))
        lying = ((self._shape(name, beliefs), place) for name, place in self._places.items())
        under = [self._planner.stand(shape, place) for shape, place in lying if shape is not None]
        return [*tasks, *self._kept_free(under)]

    def _kept_free(self, under: Sequence[Ints]) -> Iterator[Task]:
        """Places that are kept free for what comes, of those that nothing is on, by the tiles."""
        for free in self._kept_free_places:
            kept = self._planner.stand(free.shape, free.pose)
            if not any(np.isin(kept, tiles).any() for tiles in under):
                yield Task(free.name, free.shape, free.pose[None, :])

    def _goal(self, name: str, pose: Floats) -> tuple[Floats | None, bool]:
        """Where a parcel is to go by the plan, and whether it leaves there."""
        order = self._asked.get(name)
        if order is None:
            return None, False
        if isinstance(order.goal, Gate):
            return self._way_out(name, order.goal, pose), True
        yaw_rad = float(pose[2]) if order.goal.yaw_rad is None else order.goal.yaw_rad
        return np.array([order.goal.x_m, order.goal.y_m, yaw_rad]), False

    def _way_out(self, name: str, gate: Gate, pose: Floats) -> Floats:
        """The end of a route over a gate: as near to straight ahead as the stretch is wide."""
        corners_m = self._loads[name].bottom.outline_m(np.array([0.0, 0.0, pose[2]]))
        axis = 1 - gate.outward[0]
        half_m = float(abs(corners_m[:, axis]).max())
        low_m, high_m = gate.from_m + half_m, gate.to_m - half_m
        along_m = gate.middle_m if low_m > high_m else min(max(float(pose[axis]), low_m), high_m)
        return np.array([*gate.place_m(_OUT_M, along_m), float(pose[2])])

    def _kept(self) -> dict[str, Route]:
        """The routes of those that are under way, as far as they are left."""
        if self._plan is None:
            return {}
        progress_m = {
            name: ride.progress_m for name, ride in self._rides.items() if not ride.has_come
        }
        return self._planner.kept(self._plan, progress_m, self._now_s)

    # Motion

    def _drive(self, beliefs: Mapping[str, Belief], step_s: float) -> Iterator[tuple[str, Carried]]:
        """How each parcel that is under way is carried."""
        limits_m = self._limits_m()
        self._find_held()
        for name, ride in self._rides.items():
            belief = beliefs.get(name)
            if belief is None:
                continue
            room = self._room_to_turn(name)
            free_m = self._free_m(name, ride)
            ride.obstructed = free_m < ride.route.length_m or name in self._held
            limit_m = min(limits_m.get(name, inf), free_m)
            carried = ride.step(belief, step_s, limit_m, room)
            if carried is not None:
                yield name, carried

    def _free_m(self, name: str, ride: Ride) -> float:
        """Up to where a route is free of what lies where the plan has nothing [m]."""
        visits = ride.route.visits
        free_m = inf
        for other, obstacle in self._obstacles.items():
            if other != name:
                met = np.isin(visits.tile, obstacle.tiles) & (visits.leaves_m > ride.progress_m)
                free_m = min(free_m, float(visits.enters_m[met].min(initial=inf)) - _SHORT_M)
        return free_m

    def _limits_m(self) -> dict[str, float]:
        for name, ride in self._rides.items():
            self._progress_m[name] = ride.progress_m
        return (
            {} if self._plan is None else self._plan.authority.limits_m(self._there_m(self._plan))
        )

    def _there_m(self, plan: Plan) -> dict[str, float]:
        """How far those have come who are on the table; others are in nobody's way any more."""
        return {
            name: self._progress_m.get(name, 0.0)
            for name in plan.routes
            if name in self._places and name not in self._gone
        }

    def _find_held(self) -> None:
        """Find who waits for one that stays, having no way, or no order any more."""
        if self._plan is None:
            return
        there_m, riding = self._there_m(self._plan), frozenset(self._rides)
        still = there_m.keys() - riding - (self._orders.keys() - self._blocked.keys())
        by = riding, frozenset(still)
        if by != self._held_by:
            self._held, self._held_by = self._plan.authority.held(there_m, still), by

    def _room_to_turn(self, name: str) -> bool:
        """Whether a parcel may turn where it is without coming near any other."""
        mine, reach_m = self._places[name], self._loads[name].bottom.reach_m
        for other, place in self._places.items():
            if other != name:
                shape = self._shapes.get(other)
                theirs_m = reach_m if shape is None else shape.bottom.reach_m
                if hypot(*(place - mine)[:2].tolist()) < reach_m + theirs_m + _NEAR_M:
                    return False
        return True

    def _outline(self, name: str, beliefs: Mapping[str, Belief]) -> Bottom:
        return beliefs[name].outline if name in beliefs else self._loads[name].bottom


def _shape_of(load: Load) -> Shape:
    return Shape(load.bottom, load.mass.centre_m)
