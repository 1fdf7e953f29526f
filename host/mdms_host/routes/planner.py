"""Routes for all parcels of a table: one after another, each around those before it.

Prioritised planning with safe intervals (M. Cap, P. Novak, A. Kleiner, M. Selecky, 2015): a parcel
that is yet to be planned stands where it is for all time, and one that is planned keeps its route.
Where each can go on its own past the starts of those after it and the goals of those before it,
a route is found for all: at worst it waits until those before it have come to their goals.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from random import Random

import numpy as np

from mdms_host.routes.aside import places_aside
from mdms_host.routes.authority import Authority
from mdms_host.routes.blocked import Blocked, Blocker, blockers
from mdms_host.routes.cost_to_go import Guide, barred_joins, cost_to_go
from mdms_host.routes.errand import Errand, Ground, Task, own_ends, turned_rad
from mdms_host.routes.lattice import Lattice
from mdms_host.routes.moves import LatticeMoves, free_runs, lattice_moves
from mdms_host.routes.pace import Pace, TrapezoidPace
from mdms_host.routes.reservations import Reservations
from mdms_host.routes.retiming import retimed
from mdms_host.routes.route import Route
from mdms_host.routes.safe_intervals import TakenTiles
from mdms_host.routes.search import Errands, Found, search
from mdms_host.routes.shape import Shape
from mdms_host.routes.standing import Standing
from mdms_host.routes.tiles import Tiles
from mdms_host.routes.well_formed import ill_formed, order_of
from mdms_model.arrays import Bools, Floats, Ints


@dataclass(frozen=True)
class Plan:
    """A route for each parcel, of one pose where it stays, and why those with a goal stay."""

    routes: Mapping[str, Route]
    blocked: Mapping[str, Blocked]
    order: tuple[str, ...]
    """The parcels with routes, in the order in which they were planned."""
    reservations: Reservations
    authority: Authority


@dataclass
class _Table:
    """Who holds which tile, while routes are planned one by one."""

    tiles: int
    closed: Bools
    gap_s: float
    taken: TakenTiles = field(init=False)
    holders: Ints = field(init=False)
    """How many parcels that are not planned yet stand on each tile."""

    def __post_init__(self) -> None:
        self.taken, self.holders = TakenTiles(self.tiles), np.zeros(self.tiles, dtype=np.int64)

    def stand(self, errand: Errand, count: int = 1) -> None:
        """A parcel stands where it is for all time; with -1 it no longer does."""
        np.add.at(self.holders, errand.stand, count)

    def take(self, owner: int, route: Route) -> None:
        """A parcel takes the tiles of its route while it is on them, and a while more."""
        _, _, _, enters_s, leaves_s = route.visits
        self.taken.take(owner, route.visits.tile, enters_s - self.gap_s, leaves_s + self.gap_s)

    def blocked(self) -> Bools:
        """The tiles that are closed, or held by those not planned yet."""
        return self.closed | (self.holders > 0)


class Planner:
    """Plans for one table. It keeps what it works out of a shape, so that the second plan is quick.

    `clearance_m` is how much every outline is grown by, `gap_s` how long a tile is free between two
    parcels, `step` how many tiles lattice places are apart; `tries` is how many orders of the
    parcels are tried where one does not do. `efforts` are by how much a route may take longer than
    the soonest, and after how many states of the search the next effort is made.
    """

    def __init__(
        self,
        tiles: Tiles,
        pace: Pace | None = None,
        *,
        clearance_m: float = 0.01,
        step: int = 1,
        gap_s: float = 0.2,
        tries: int = 6,
        efforts: tuple[tuple[float, int], ...] = ((1.5, 300), (8.0, 2**31)),
    ) -> None:
        if tiles.per_pitch % step:
            raise ValueError(
                f"places must come alike in every cell: a step of {step} tiles does not divide the "
                f"{tiles.per_pitch} of a cell"
            )
        self._ground = Ground(tiles, pace or TrapezoidPace(), clearance_m)
        self._step = step
        self._gap_s = gap_s
        self._tries = tries
        self._efforts = efforts
        self._standings: dict[Shape, Standing] = {}
        self._ways: dict[tuple[Shape, tuple[float, ...]], LatticeMoves] = {}

    @property
    def tiles(self) -> Tiles:
        """The tiles of the table."""
        return self._ground.tiles

    def stand(self, shape: Shape, pose: Floats) -> Ints:
        """The tiles that a parcel takes where it stands."""
        return self._ground.stand(shape, pose)

    def plan(
        self,
        tasks: Sequence[Task],
        now_s: float = 0.0,
        *,
        closed: Bools | None = None,
        kept: Mapping[str, Route] | None = None,
        seed: int = 1,
    ) -> Plan:
        """Routes for all these parcels, first ones first where that does.

        Tiles that are `closed` are not crossed. Routes that are `kept` are those of other parcels,
        with their times from now on (`retiming`); they are planned around, and part of the plan.
        """
        closed = self._nothing() if closed is None else closed
        kept = kept or {}
        errands = {task.parcel: self._errand(task, now_s) for task in tasks}
        moving = [name for name, errand in errands.items() if errand.task.goal is not None]
        best: dict[str, Route] = {}
        for order, sure in self._orders(errands, moving, closed, seed):
            found = self._attempt(errands, order, closed, kept, sure)
            if len(found) >= len(best):
                best = found
            if len(best) == len(moving):
                break
        routes = {**kept, **{name: errand.prefix for name, errand in errands.items()}, **best}
        blocked = {
            name: self._blocked(errands, name, best, closed, kept)
            for name in moving
            if name not in best
        }
        reservations = Reservations(routes)
        return Plan(routes, blocked, (*kept, *best), reservations, Authority(reservations))

    def _orders(
        self, errands: Mapping[str, Errand], moving: Sequence[str], closed: Bools, seed: int
    ) -> Iterator[tuple[Sequence[str], bool]]:
        """Orders of planning: as given, one that the layout is well-formed by, and by chance.

        With each whether to keep to ways that are sure, as `_planned` has it.
        """
        yield moving, True
        order = order_of(errands, closed, self._free)
        if order is not None:
            yield order, True
        random = Random(f"orders {seed}")
        for number in range(self._tries):
            yield random.sample(list(moving), len(moving)), number % 2 == 0

    def well_formed(self, tasks: Sequence[Task], *, closed: Bools | None = None) -> bool:
        """Whether the parcels could go one after another, so that there is a plan for all."""
        closed = self._nothing() if closed is None else closed
        errands = {task.parcel: self._errand(task, 0.0) for task in tasks}
        return order_of(errands, closed, self._free) is not None

    def _errand(self, task: Task, now_s: float) -> Errand:
        base_rad = turned_rad(task)
        start, goal = own_ends(task, base_rad)
        yaws_rad = tuple(task.shape.yaws_rad(float(start[2]), float(goal[2])))
        standing = self._standings.setdefault(
            task.shape, Standing(self._ground.tiles.layout, task.shape)
        )
        key = task.shape, yaws_rad
        if key not in self._ways:
            lattice = Lattice(
                self._ground.tiles, task.shape, yaws_rad, self._step, self._ground.clearance_m
            )
            self._ways[key] = lattice_moves(lattice, standing, self._ground.pace)
        return Errand(task, self._ground, self._ways[key], standing, base_rad, now_s)

    def _attempt(
        self,
        errands: Mapping[str, Errand],
        order: Sequence[str],
        closed: Bools,
        kept: Mapping[str, Route],
        sure: bool,
    ) -> dict[str, Route]:
        """Routes of as many as can be planned, each as soon as those before leave it a way."""
        table = _Table(self._ground.tiles.count, closed, self._gap_s)
        errands = dict(errands)
        owners = {name: number for number, name in enumerate((*errands, *kept))}
        for name, route in kept.items():
            table.take(owners[name], route)
        for name, errand in errands.items():
            table.stand(errand)
            if len(errand.prefix.begins_s):
                table.take(owners[name], errand.prefix)
        parked = self._nothing()
        for route in kept.values():
            parked[route.visits.tile[np.isinf(route.visits.leaves_s)]] = True
        found: dict[str, Route] = {}
        waiting = list(order)
        while waiting:
            before = len(found)
            for name in waiting:
                way = self._planned(errands[name], owners[name], table, parked, sure)
                if way is not None:
                    found[name] = way
                    parked[errands[name].goal_stand] = True
            waiting = [name for name in waiting if name not in found]
            if len(found) == before and not self._made_way(errands, waiting, owners, table, parked):
                break
        return found

    def _made_way(
        self,
        errands: dict[str, Errand],
        waiting: Sequence[str],
        owners: Mapping[str, int],
        table: _Table,
        parked: Bools,
    ) -> bool:
        """Whether one of those who all have no way goes aside so that another has one.

        It goes on from there; each goes aside once.
        """
        wanted = self._nothing()
        for name in waiting:
            wanted[errands[name].goal_stand] = True
        for name in waiting:
            errand = errands[name]
            if errand.so_far is not None:
                continue
            table.stand(errand, -1)
            blocked = table.blocked() | parked
            table.stand(errand)
            for pose in places_aside(errand, blocked | wanted):
                aside = errand.aside(pose)
                others = [errands[other] for other in waiting if other != name]
                if self._lets_go(others, table, blocked, aside.goal_stand):
                    route = self._planned(aside, owners[name], table, parked, True)
                    if route is not None:
                        errands[name] = errand.onward(route)
                        table.stand(errands[name])
                        return True
        return False

    def _lets_go(
        self, errands: Sequence[Errand], table: _Table, blocked: Bools, aside: Ints
    ) -> bool:
        """Whether one of these has a way when another, who is not in `blocked`, stands aside."""
        for errand in errands:
            others = blocked.copy()
            others[errand.stand] = False
            others[aside] = True
            if self._free(errand, others):
                return True
        return False

    def _planned(
        self, errand: Errand, owner: int, table: _Table, parked: Bools, sure: bool
    ) -> Route | None:
        """The route of one parcel, which then takes its tiles; None: it stays where it stood.

        `sure` keeps to ways past all goals that are taken, on which it needs but wait for success.
        """
        table.stand(errand, -1)
        table.taken.release(owner)
        route = self._found(errand, table, table.blocked() | parked if sure else table.blocked())
        if route is None:
            table.stand(errand)
        if route is not None or len(errand.prefix.begins_s):
            table.take(owner, errand.prefix if route is None else route)
        return route

    def _found(self, errand: Errand, table: _Table, blocked: Bools) -> Route | None:
        roadmap = errand.roadmap
        while True:
            guide = _guide(errand, blocked)
            if guide.cost_s[roadmap.start_node] == np.inf:
                return None
            stay_s = errand.task.leaves_s + self._gap_s if errand.task.leaves else np.inf
            ends = Errands(roadmap.start_node, roadmap.goal_node, errand.ready_s, stay_s)
            for weight, most in self._efforts:
                found = search(roadmap.graph, guide, table.taken.taken, ends, (weight, most))
                if found.reached or found.states < most:
                    break
            unsafe = self._unsafe(errand, found)
            if not found.reached:
                return None
            if unsafe is None:
                return errand.route(found)
            roadmap.without(unsafe)

    @staticmethod
    def _unsafe(errand: Errand, found: Found) -> int | None:
        """A join of the way on which the parcel might tip."""
        joins = [-1 - move for move in found.moves.tolist() if move < 0]
        return next((join for join in joins if not errand.roadmap.stands(join)), None)

    def kept(self, plan: Plan, progress_m: Mapping[str, float], now_s: float) -> dict[str, Route]:
        """The routes of a plan from where these parcels are now, for others to be planned around.

        `progress_m` is without those that are to be planned anew, and without those that are gone.
        """
        return retimed(plan.reservations, progress_m, now_s, self._ground.pace, self._gap_s)

    def ill_formed(
        self, tasks: Sequence[Task], *, closed: Bools | None = None
    ) -> tuple[Blocked, ...]:
        """Parcels that others would be in the way of, stood they all at their starts and goals.

        None: the layout is well-formed, and there is a plan for it, whatever is planned first.
        """
        closed = self._nothing() if closed is None else closed
        errands = {task.parcel: self._errand(task, 0.0) for task in tasks}
        return ill_formed(errands, closed, self._free)

    def _nothing(self) -> Bools:
        return np.zeros(self._ground.tiles.count, dtype=bool)

    @staticmethod
    def _free(errand: Errand, blocked: Bools) -> bool:
        """Whether a parcel on its own has a way past these tiles."""
        cost_s = _guide(errand, blocked).cost_s
        return bool(np.isfinite(cost_s[errand.roadmap.start_node]))

    def _blocked(
        self,
        errands: Mapping[str, Errand],
        name: str,
        routes: Mapping[str, Route],
        closed: Bools,
        kept: Mapping[str, Route],
    ) -> Blocked:
        """Why a parcel has no route: the fewest places that would have to be given up."""
        places: list[tuple[Blocker, Ints]] = []
        for other, its in errands.items():
            if other in routes:
                places.append((Blocker(other, "goal", _end(routes[other])), its.goal_stand))
            elif other != name:
                places.append((Blocker(other, "place", its.task.start), its.stand))
        for other, route in kept.items():
            stays = route.visits.tile[np.isinf(route.visits.leaves_s)]
            places.append((Blocker(other, "goal", _end(route)), stays))
        own = errands[name]
        by = blockers(places, closed, partial(self._free, own))
        return Blocked(name, own.task.start, own.task.goal, *by)


def _guide(errand: Errand, blocked: Bools) -> Guide:
    """What is open to a parcel past these tiles."""
    ways, roadmap = errand.ways, errand.roadmap
    lattice = ways.lattice
    runs = free_runs(ways.moves, lattice.bases, lattice.places, ways.open_lines, blocked)
    barred = barred_joins(roadmap.graph, blocked)
    cost_s = cost_to_go(roadmap.graph, runs, barred, ways.often, roadmap.goal_node)
    return Guide(runs, barred, ways.often, cost_s)


def _end(route: Route) -> Floats:
    end: Floats = route.poses[-1]
    return end
