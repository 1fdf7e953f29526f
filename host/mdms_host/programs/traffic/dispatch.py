"""Has plans made for those that stand and are to go somewhere, and gives them their routes.

Plans are made off the cycle: asked for in one, they take effect some cycles later.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from mdms_host.estimation.footprint import gap_m
from mdms_host.programs.order import Gate, Order
from mdms_host.programs.traffic.world_state import Timetable, WorldState, shape_of
from mdms_host.routes.planner import Planner, RoutePlan
from mdms_host.routes.planning_problem import Blocked, RouteTask
from mdms_host.routes.route import Route
from mdms_host.routes.support import Shape
from mdms_model.arrays import Bools, Floats, Ints

#: A plan takes effect so many cycles after it was asked for, or when it is ready if that is later.
DELAY_CYCLES = 3


class PlanExecutor(Protocol):
    """Where plans are made, one at a time; `real_time` is whether time passes meanwhile."""

    @property
    def real_time(self) -> bool:
        """Whether the cycle goes on while a plan is made."""
        ...

    @property
    def is_busy(self) -> bool:
        """Whether a plan has been asked for that has not been taken yet."""
        ...

    def ask(self, work: Callable[[], RoutePlan]) -> None:
        """Have a plan made."""
        ...

    def take(self) -> RoutePlan | None:
        """The plan that was asked for, once it is ready; called once a cycle."""
        ...


class VirtualExecutor:
    """Makes plans at once and holds them back: virtual time does not pass by computing."""

    real_time = False

    def __init__(self) -> None:
        self._plan: RoutePlan | None = None
        self._cycles = 0

    @property
    def is_busy(self) -> bool:
        """See `PlanExecutor`."""
        return self._plan is not None

    def ask(self, work: Callable[[], RoutePlan]) -> None:
        """See `PlanExecutor`."""
        self._plan, self._cycles = work(), 0

    def take(self) -> RoutePlan | None:
        """See `PlanExecutor`."""
        if self._plan is None:
            return None
        self._cycles += 1
        if self._cycles < DELAY_CYCLES:
            return None
        plan, self._plan = self._plan, None
        return plan


class ThreadExecutor:
    """Makes plans in a thread of its own, beside the cycle in real time."""

    real_time = True

    def __init__(self) -> None:
        self._executor = ThreadPoolExecutor(1, "planning")
        self._future: Future[RoutePlan] | None = None
        self._cycles = 0

    @property
    def is_busy(self) -> bool:
        """See `PlanExecutor`."""
        return self._future is not None

    def ask(self, work: Callable[[], RoutePlan]) -> None:
        """See `PlanExecutor`."""
        self._future, self._cycles = self._executor.submit(work), 0

    def take(self) -> RoutePlan | None:
        """See `PlanExecutor`; raises the planner's error."""
        if self._future is None:
            return None
        self._cycles += 1
        if self._cycles < DELAY_CYCLES or not self._future.done():
            return None
        plan, self._future = self._future.result(), None
        return plan


#: A parcel that leaves is taken so soon after it has come to the end of its route [s].
_LEAVES_S = 0.3
#: How far beyond the last support its route ends [m]: before it, for it has wheels there. A parcel
#: that is as far out already has so much more to go.
_OUT_M = -0.01
_FARTHER_M = 0.02
#: A move that is planned for practice [m], with so little of a turn [rad].
_LITTLE_M, _LITTLE_RAD = 0.1, 0.01
#: Two that stand on the same tile come no nearer than this, or by so little, when one goes; its way
#: is looked at in steps of so much [m].
_APART_M, _NEARER_M = 0.01, 0.001
_LOOKED_M = 0.01
#: At least so large a share of the tiles under a parcel must be of cells that live: the wheels of
#: lost ones brake nothing.
_LIVING = 0.5
#: A goal may be so near to where another parcel stands [m].
_BESIDE_M = 0.003


@dataclass(frozen=True, slots=True)
class KeptFree:
    """A place that is kept free by all that does not lie there, as if something of a shape did."""

    name: str
    pose: Floats
    shape: Shape


@dataclass(frozen=True, slots=True)
class WayRules:
    """Where ways may lead, and end.

    Places of `kept_free` are not crossed: somebody may set a parcel down there at any time. Ways
    lead around lost cells, or `over_lost` ones if more parcels have a way then. Goals may be
    `beside` where others stand, on tiles of these.
    """

    kept_free: Sequence[KeptFree] = ()
    over_lost: bool = True
    beside: bool = True


@dataclass(frozen=True, slots=True)
class NoWay:
    """Why a parcel has no way; `may_pass` is whether the obstacle may go away.

    `by_unknown` is whether the obstacle is an unknown thing.
    """

    text: str
    may_pass: bool
    by_unknown: bool = False


class Dispatch:
    """Between orders and planner: `blocked` are parcels without a way by the last plan, and why."""

    def __init__(
        self,
        planner: Planner,
        executor: PlanExecutor,
        world_state: WorldState,
        timetable: Timetable,
        rules: WayRules,
    ) -> None:
        self.blocked: dict[str, NoWay] = {}
        self._planner = planner
        self._executor = executor
        self._loads = world_state.loads
        self._world_state = world_state
        self._timetable = timetable
        self._rules = rules
        self._closed: Bools = np.zeros(planner.tiles.count, dtype=bool)
        #: Tiles that were closed after the plan that is being made was asked for.
        self._closed_since: Bools = self._closed.copy()
        #: The parcels of that plan, with their orders.
        self._asked: dict[str, Order] = {}
        if executor.real_time:
            self._prepare()

    def _prepare(self) -> None:
        """Have the planner prepare its data for every kind of parcel."""
        for shape in dict.fromkeys(map(shape_of, self._loads.values())):
            for yaw_rad in (_LITTLE_RAD, -_LITTLE_RAD):
                start, goal = np.array([0.0, 0.0, yaw_rad]), np.array([_LITTLE_M, 0.0, yaw_rad])
                self._planner.plan([RouteTask("any", shape, start, goal)])

    @property
    def is_busy(self) -> bool:
        """Whether a plan is being made."""
        return self._executor.is_busy

    def close(self, cells: Collection[int]) -> Ints:
        """These cells (from 1) are lost, and no others; the tiles that were open until now."""
        closed = np.zeros_like(self._closed)
        for cell in cells:
            closed[self._planner.tiles.of_cell(cell)] = True
        newly = closed & ~self._closed
        self._closed = closed
        self._closed_since |= newly
        return np.flatnonzero(newly)

    def take(self) -> Iterator[tuple[Order, Route]]:
        """The routes of a plan that has just become ready, but for those that it does not suit.

        A way over cells that were lost while it was made is none.
        """
        plan = self._executor.take()
        if plan is None:
            return
        self._timetable.begin(plan)
        asked, self._asked, self.blocked = self._asked, {}, {}
        late = np.flatnonzero(self._closed_since)
        for name, order in asked.items():
            if order.over:
                continue
            if name in plan.blocked:
                self.blocked[name] = self._no_way(plan.blocked[name])
            elif name in plan.routes and not plan.routes[name].meets(late):
                yield order, plan.routes[name]

    def _no_way(self, blocked: Blocked) -> NoWay:
        unknown = [name for name in self._world_state.places if name not in self._loads]
        by = {blocker.parcel for blocker in blocked.by}
        if blocked.closed and unknown and not self._closed.any():
            # Places that an unknown thing may reach are closed to parcels that it may touch.
            text = f"{blocked.way}: blocked by {' and '.join(unknown)}, which may reach to it"
            return NoWay(text, may_pass=True, by_unknown=True)
        # Nobody is led over where a lost parcel was, though a person may see nothing there.
        unseen = [f"no sensor shows {name} now" for name in sorted(by & self._world_state.unseen)]
        text = "; ".join((str(blocked), *unseen))
        return NoWay(text, blocked.may_pass, by_unknown=not by.isdisjoint(unknown))

    def ask(
        self, wanting: Mapping[str, Order], riding_m: Mapping[str, float], now_s: float
    ) -> None:
        """Have a plan made for those of `wanting`, around all that ride.

        `riding_m` is how far these have come on their routes.
        """
        self._asked = dict(wanting)
        self._closed_since[:] = False
        self._timetable.asked()
        plan = self._timetable.plan
        under = self._world_state.under()
        old = {} if plan is None else plan.beside
        beside = {name: its for name, its in old.items() if name in riding_m}
        passed = {other for its in beside.values() for other in its if other in under}
        out = self._too_near(under) | passed
        tasks = [*self._tasks(riding_m.keys() | out), *self._kept_free(under.values())]
        # Parcels that stopped on their ways are left time for the rest of these.
        stopped_m = self._timetable.stopped_m(
            {task.parcel: task.start for task in tasks if task.parcel in wanting}
        )
        come_m = {**stopped_m, **riding_m}
        kept = {} if plan is None else self._planner.kept(plan, come_m, now_s)
        never = np.zeros_like(self._closed)
        for name in out:
            never[under[name]] = True
        lost = self._closed.copy()
        self._executor.ask(partial(self._planned, tasks, now_s, kept, never, lost, beside=beside))

    def _planned(
        self,
        tasks: list[RouteTask],
        now_s: float,
        kept: dict[str, Route],
        never: Bools,
        lost: Bools,
        *,
        beside: Mapping[str, Mapping[str, Floats]],
    ) -> RoutePlan:
        """A plan around the tiles of lost cells; see above.

        Where two stand on the same tile neither has a way, nor has a parcel whose goal is on a tile
        of another. Then it goes by a way on which it comes no nearer to the other than at the ends.
        The other is planned for later. `beside` are those that are passed so now.
        """
        plan = self._around(tasks, now_s, kept, never, lost)
        under = {task.parcel: self._planner.stand(task.shape, task.start) for task in tasks}
        for name in plan.blocked:
            (mine,) = (task for task in tasks if task.parcel == name)
            near = [task for task in tasks if task is not mine and self._meet(mine, task)]
            if not near:
                continue
            shut = never.copy()
            for task in near:
                shut[under[task.parcel]] = True
            goal = self._goal_tiles(mine)
            shared = goal[shut[goal] & ~never[goal]]
            shut[shared] = False
            stay = {task.parcel for task in near}
            others = [task for task in tasks if task.parcel not in stay]
            rest = {other: route for other, route in kept.items() if other not in stay}
            first = self._around(others, now_s, rest, shut, lost)
            others_meet = (
                route.meets(shared) for other, route in first.routes.items() if other != name
            )
            if name in first.blocked or any(others_meet):
                continue
            if self._parts(first.routes[name], mine, near):
                own = {task.parcel: task.start for task in near}
                return replace(first, beside={**beside, name: own})
        return replace(plan, beside=beside)

    def _goal_tiles(self, task: RouteTask) -> Ints:
        """The tiles that a parcel is to stand on at last; none if it leaves the table there."""
        if task.goal is None or task.leaves:
            return np.zeros(0, dtype=np.intp)
        return self._planner.stand(task.shape, task.goal)

    def _meet(self, mine: RouteTask, other: RouteTask) -> bool:
        """Whether another stands on a tile of a parcel's place, or of its goal, and near enough."""
        under = self._planner.stand(other.shape, other.start)
        if np.isin(under, self._planner.stand(mine.shape, mine.start)).any():
            return True
        goal = mine.goal
        return (
            self._rules.beside
            and goal is not None
            and other.parcel not in {free.name for free in self._rules.kept_free}
            and bool(np.isin(under, self._goal_tiles(mine)).any())
            and _gap_m(mine, goal, other) >= self._beside_m(other)
        )

    def _beside_m(self, other: RouteTask) -> float:
        """How near to another a goal may be [m]; no nearer than a way to something unknown."""
        return _BESIDE_M if other.parcel in self._loads else _APART_M

    def _parts(self, route: Route, mine: RouteTask, near: Sequence[RouteTask]) -> bool:
        """Whether a parcel comes no nearer to those near its route than it may be."""
        count = int(route.length_m / _LOOKED_M) + 2
        along_m = np.linspace(0.0, route.length_m, count).tolist()
        poses = [route.pose_at(each_m) for each_m in along_m]
        for other in near:
            gaps_m = [_gap_m(mine, pose, other) for pose in poses]
            goal_m = max(gaps_m[-1], self._beside_m(other))
            if min(gaps_m) < min(gaps_m[0], goal_m, _APART_M) - _NEARER_M:
                return False
        return True

    def _around(
        self,
        tasks: list[RouteTask],
        now_s: float,
        kept: dict[str, Route],
        never: Bools,
        lost: Bools,
    ) -> RoutePlan:
        plan = self._planner.plan(tasks, now_s, closed=never | lost, kept=kept)
        if plan.blocked and self._rules.over_lost and lost.any():
            over = self._planner.plan(tasks, now_s, closed=never, kept=kept)
            shapes = {task.parcel: task.shape for task in tasks}
            ways = ((route, shapes[name]) for name, route in over.routes.items() if name in shapes)
            braked = all(self._is_braked(route, shape, lost) for route, shape in ways)
            return over if braked and len(over.blocked) < len(plan.blocked) else plan
        return plan

    def _is_braked(self, route: Route, shape: Shape, lost: Bools) -> bool:
        """Whether enough cells under a parcel live all along its way, or no fewer than now."""
        count = int(route.length_m / _LOOKED_M) + 2
        poses = map(route.pose_at, np.linspace(0.0, route.length_m, count).tolist())
        living = [1.0 - float(lost[self._planner.stand(shape, pose)].mean()) for pose in poses]
        return min(living) >= min(living[0], _LIVING)

    def _too_near(self, under: Mapping[str, Ints]) -> set[str]:
        """Unknown things that may reach to a parcel's place, which the parcel must leave.

        The outline of such a thing contains it, and more: a parcel that stands there shows that the
        thing does not reach so far.
        """
        mine = [tiles for name, tiles in under.items() if name in self._loads]
        taken = np.concatenate(mine) if mine else np.zeros(0, dtype=np.intp)
        return {
            name
            for name, tiles in under.items()
            if name not in self._loads and np.isin(tiles, taken).any()
        }

    def _tasks(self, others: Collection[str]) -> Iterator[RouteTask]:
        """All that stands, but for some others, with the goals of those that are to go."""
        for name, pose in self._world_state.places.items():
            shape = self._world_state.shape(name)
            if name not in others and shape is not None:
                goal, leaves = self._goal(name, pose)
                yield RouteTask(name, shape, pose, goal, leaves, _LEAVES_S)

    def _kept_free(self, under: Collection[Ints]) -> Iterator[RouteTask]:
        """Places that are kept free for coming parcels, of those that are empty."""
        for free in self._rules.kept_free:
            kept = self._planner.stand(free.shape, free.pose)
            if not any(np.isin(kept, tiles).any() for tiles in under):
                yield RouteTask(free.name, free.shape, free.pose)

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
        corners_m = self._loads[name].footprint.outline_m(np.array([0.0, 0.0, pose[2]]))
        axis = 1 - gate.outward[0]
        half_m = float(abs(corners_m[:, axis]).max())
        low_m, high_m = gate.from_m + half_m, gate.to_m - half_m
        along_m = gate.middle_m if low_m > high_m else min(max(float(pose[axis]), low_m), high_m)
        out_m = gate.out_m(*pose[:2].tolist())
        end_m = out_m + _FARTHER_M if out_m > _OUT_M - _FARTHER_M else _OUT_M
        return np.array([*gate.place_m(end_m, along_m), float(pose[2])])


def _gap_m(mine: RouteTask, pose: Floats, other: RouteTask) -> float:
    """How far a parcel at a pose is from another at its place [m]."""
    return gap_m(mine.shape.footprint, pose, other.shape.footprint, other.start)
