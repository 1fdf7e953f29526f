"""One attempt at a plan: routes of all parcels in turn, and places to stand aside."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from itertools import permutations

import numpy as np

from mdms_host.routes.interval_search import FoundWay, SearchEnds, TakenTiles, search
from mdms_host.routes.planning_problem import Ground, PlanningProblem
from mdms_host.routes.route import Route
from mdms_host.routes.ways_alone import (
    Alone,
    Guide,
    barred_joins,
    cost_to_go,
    free_runs,
    places_under,
    steps_of,
    with_closed,
)
from mdms_model.arrays import Bools, Floats, Ints

#: So many places are tried, the nearest first.
_TRIES = 16


def places_aside(problem: PlanningProblem, blocked: Bools) -> Iterator[tuple[int, Floats]]:
    """Nodes of the lattice and their poses, turned about as the parcel is, free of these tiles.

    They are more than a step from each other, so that few are tried.
    """
    lattice, tiles = problem.ways.lattice, problem.ground.tiles
    start = problem.roadmap.start
    apart_m = 2 * lattice.step * tiles.side_m
    yaw = int(np.argmin(np.abs(np.array(lattice.yaws_rad) - start[2])))
    own = yaw * lattice.places + np.arange(lattice.places)
    own = own[problem.ways.on_table[own]]
    stand = problem.ways.stand_tile[problem.ways.stand[yaw] : problem.ways.stand[yaw + 1]]
    own = own[~blocked[lattice.bases[own][:, None] + stand].any(axis=1)]
    poses = lattice.poses[own]
    away_m = np.hypot(*(poses[:, :2] - start[:2]).T)
    tried: list[Floats] = []
    for index in np.argsort(away_m, kind="stable").tolist():
        pose = poses[index]
        if all(np.hypot(*(pose - other)[:2]) > apart_m for other in tried):
            tried.append(pose)
            yield int(own[index]), pose + np.array([0.0, 0.0, problem.turned_rad])
        if len(tried) == _TRIES:
            return


#: Moves that a search tries: as many as it takes, and where it may be in vain.
MANY, _IN_VAIN = 2**31, 16_000


class Aside(Enum):
    """When others go aside for a parcel that has no way."""

    NEVER = "never"
    LATE = "when nobody has a way"
    EARLY = "for the first that has none"


@dataclass(frozen=True)
class Terms:
    """Data that all attempts share: `efforts` are weights of a search, with moves at most."""

    ground: Ground
    gap_s: float
    efforts: tuple[tuple[float, int], ...]


@dataclass
class TileTable:
    """Holders of the tiles, while routes are planned one by one."""

    tiles: int
    closed: Bools
    gap_s: float
    taken: TakenTiles = field(init=False)
    holders: Ints = field(init=False)
    """How many parcels that are not planned yet stand on each tile."""

    def __post_init__(self) -> None:
        self.taken, self.holders = TakenTiles(self.tiles), np.zeros(self.tiles, dtype=np.int64)

    def stand(self, problem: PlanningProblem, count: int = 1) -> None:
        """A parcel stands where it is for all time; with -1 it no longer does."""
        np.add.at(self.holders, problem.stand, count)

    def take(self, owner: int, route: Route) -> None:
        """A parcel takes the tiles of its route while it is on them, and a while more."""
        _, _, _, enters_s, leaves_s = route.visits
        self.taken.take(owner, route.visits.tile, enters_s - self.gap_s, leaves_s + self.gap_s)

    def blocked(self, under: Ints | None = None) -> Bools:
        """The tiles that are closed, or held by those not planned yet.

        Those `under` a parcel do not count as closed to it, so that it can leave them.
        """
        blocked = self.closed.copy()
        if under is not None:
            blocked[under] = False
        return blocked | (self.holders > 0)


class Attempt:
    """Parcels of which some have routes. Routes that are `kept` are of others.

    `sure` keeps to ways past all goals that are taken, on which a parcel needs but wait for
    success.
    """

    def __init__(
        self,
        terms: Terms,
        problems: Mapping[str, PlanningProblem],
        closed: Bools,
        kept: Mapping[str, Route],
        sure: bool,
    ) -> None:
        self._terms = terms
        self._problems = dict(problems)
        self._sure = sure
        self._owners = {name: number for number, name in enumerate((*problems, *kept))}
        self._table = TileTable(terms.ground.tiles.count, closed, terms.gap_s)
        self._parked = np.zeros(terms.ground.tiles.count, dtype=bool)
        for name, route in kept.items():
            self._table.take(self._owners[name], route)
            self._parked[route.stays] = True
        for problem in problems.values():
            self._table.stand(problem)

    def run(self, order: Sequence[str], aside: Aside) -> dict[str, Route]:
        """Routes of as many as can be planned, in this order where that does.

        Where nobody goes aside, the first that has no way is the end of it. Where one went aside
        for others and has no way on from there, they are those found before anybody went.
        """
        found: dict[str, Route] = {}
        unaided: dict[str, Route] = {}
        waiting = list(order)
        while waiting:
            before = len(found)
            for name in waiting:
                way = self._planned(name, self._problems[name])
                if way is not None:
                    found[name] = way
                    self._parked[self._problems[name].goal_stand] = True
                elif aside is Aside.NEVER:
                    return found
                elif aside is Aside.EARLY:
                    self._made_way([other for other in waiting if other not in found], [name])
            waiting = [name for name in waiting if name not in found]
            if all(problem.so_far is None for problem in self._problems.values()):
                unaided = dict(found)
            stuck = len(found) == before
            if stuck and not self._made_way(waiting, waiting) and not self._both_aside(waiting):
                break
        if any(self._problems[name].so_far is not None for name in waiting):
            return unaided
        return found

    def _planned(self, name: str, problem: PlanningProblem) -> Route | None:
        """The route of one parcel, which then takes its tiles; None: it stays where it stood."""
        table, owner = self._table, self._owners[name]
        table.stand(problem, -1)
        table.taken.release(owner)
        route = self._found(problem)
        if route is None:
            table.stand(problem)
        if route is not None or not problem.is_at_rest:
            table.take(owner, problem.prefix if route is None else route)
        return route

    def _found(self, problem: PlanningProblem) -> Route | None:
        """An early route, on which the parcel is safe from tipping."""
        blocked = self._table.blocked(problem.stand)
        if self._sure:
            blocked |= self._parked
        found = self._searched(problem, blocked)
        while found is not None and not problem.roadmap.is_safe(found.moves):
            found = self._searched(problem, blocked)
        return None if found is None else problem.route(found)

    def _searched(self, problem: PlanningProblem, blocked: Bools) -> FoundWay | None:
        """The way that the first effort finds which comes to an end; None: there is none."""
        roadmap, task = problem.roadmap, problem.task
        guide = guide_of(problem, blocked)
        if guide.cost_s[roadmap.start_node] == np.inf:
            return None
        stay_s = task.leaves_s + self._terms.gap_s if task.leaves else np.inf
        ends = SearchEnds(roadmap.start_node, roadmap.goal_node, problem.ready_s, stay_s)
        taken, limit = self._table.taken.taken, MANY if self._sure else _IN_VAIN
        for weight, moves in self._terms.efforts:
            most = min(moves, limit)
            found = search(roadmap.graph, guide, taken, ends, (weight, most))
            if found.reached:
                return found
            if found.tried < most:
                break
        return None

    # Going aside ----------------------------------------------------------------------------------

    def _made_way(self, waiting: Sequence[str], held: Sequence[str]) -> bool:
        """Whether one that waits goes aside so that another, of those `held`, has a way.

        It goes on from there; each goes aside once.
        """
        wanted = np.zeros_like(self._parked)
        for name in waiting:
            wanted[self._problems[name].goal_stand] = True
        for name in waiting:
            problem = self._problems[name]
            if problem.so_far is not None:
                continue
            self._table.stand(problem, -1)
            blocked = self._table.blocked() | self._parked
            self._table.stand(problem)
            others = [other for other in held if other != name]
            for _, pose in places_aside(problem, blocked | wanted):
                aside = problem.aside(pose)
                if self._lets_go(others, blocked, aside.goal_stand) and self._went(name, aside):
                    return True
        return False

    def _went(self, name: str, aside: PlanningProblem) -> bool:
        """Whether a parcel has a way aside, and goes on from its end."""
        route = self._planned(name, aside)
        if route is not None:
            self._problems[name] = self._problems[name].onward(route)
            self._table.stand(self._problems[name])
        return route is not None

    def _both_aside(self, waiting: Sequence[str]) -> bool:
        """Whether two that wait went aside, so that the first has a way past where the other is."""
        able = [name for name in waiting if self._problems[name].so_far is None]
        for first, second in permutations(able, 2):
            one, other = self._problems[first], self._problems[second]
            self._table.stand(one, -1)
            self._table.stand(other, -1)
            blocked = self._table.blocked() | self._parked
            self._table.stand(one)
            self._table.stand(other)
            beside = blocked.copy()
            beside[one.goal_stand] = True
            for _, pose in places_aside(other, beside):
                aside = other.aside(pose)
                for place in self._places_past(one, blocked, other.stand, aside.goal_stand):
                    if self._went(first, one.aside(place)):
                        # Where the other has no way after all, the first is aside for nothing.
                        return self._went(second, aside)
        return False

    def _places_past(
        self, problem: PlanningProblem, blocked: Bools, before: Ints, after: Ints
    ) -> Iterator[Floats]:
        """Places aside from which a parcel has a way, clear of another before and after it goes."""
        past = blocked.copy()
        past[after] = True
        cost_s = guide_of(problem, past).cost_s
        past[before] = True
        for node, pose in places_aside(problem, past):
            if cost_s[node] < np.inf:
                yield pose

    def _lets_go(self, held: Sequence[str], blocked: Bools, aside: Ints) -> bool:
        """Whether one of these has a way when another, not in `blocked`, stands aside."""
        for name in held:
            others = blocked.copy()
            others[self._problems[name].stand] = False
            others[aside] = True
            if is_free(self._problems[name], others):
                return True
        return False


def ways_alone(problem: PlanningProblem, closed: Bools, under: Ints) -> Alone:
    """The ways of a parcel on its own past tiles that are closed, and over places."""
    roadmap = problem.roadmap
    steps = steps_of(roadmap.graph, problem.ways.open_lines, with_closed(under, closed))
    return Alone(steps, (roadmap.start_node, roadmap.goal_node))


def is_free(problem: PlanningProblem, closed: Bools) -> bool:
    """Whether a parcel on its own has a way past these tiles."""
    return ways_alone(problem, closed, places_under(len(closed), ())).past(0).found


def guide_of(problem: PlanningProblem, blocked: Bools) -> Guide:
    """The parts of the graph that are open to a parcel past these tiles."""
    roadmap = problem.roadmap
    runs = free_runs(roadmap.graph, problem.ways.open_lines, blocked)
    barred = barred_joins(roadmap.graph, blocked)
    cost_s = cost_to_go(roadmap.graph, runs, barred, roadmap.goal_node)
    return Guide(runs, barred, cost_s)
