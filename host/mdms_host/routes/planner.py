"""Routes for all parcels of a table: one after another, each around those before it.

Prioritised planning with safe intervals (M. Cap, P. Novak, A. Kleiner, M. Selecky, 2015): an
unplanned parcel stands at its place for all time, and a planned one keeps its route. If each can go
on its own past the starts of those after it and the goals of those before it, a route is found for
all: at worst it waits until those before it have come to their goals.
"""

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from random import Random
from subprocess import DEVNULL, Popen

import numpy as np

from mdms_host.estimation.footprint import Rectangle
from mdms_host.layout import Layout
from mdms_host.routes import interval_search
from mdms_host.routes.attempt import MANY, Aside, Attempt, Terms, is_free
from mdms_host.routes.grid import Lattice, Tiles
from mdms_host.routes.improving import Straightening, legs_of, retimed
from mdms_host.routes.interval_search import TakenTiles
from mdms_host.routes.moves import LatticeMoves, lattice_moves
from mdms_host.routes.planning_problem import (
    Blocked,
    Blocker,
    Ground,
    PlanningProblem,
    RouteTask,
    blockers,
    own_ends,
    turned_rad,
)
from mdms_host.routes.reservations import Reservations
from mdms_host.routes.route import Pace, Route, TrapezoidPace
from mdms_host.routes.support import Shape, ShapeSupport
from mdms_host.routes.well_formed import OrderSearch, stuck
from mdms_model.arrays import Bools, Floats, Ints
from mdms_model.compiled import is_kept

__all__ = [
    "Margins",
    "Planner",
    "RoutePlan",
    "SearchSettings",
    "compile_planner",
    "planner_compiled_beside",
]


@dataclass(frozen=True)
class RoutePlan:
    """A route for each parcel, of one pose where it stays, and why those with a goal stay."""

    routes: Mapping[str, Route]
    blocked: Mapping[str, Blocked]
    order: tuple[str, ...]
    """The parcels with routes, in the order in which they were planned."""
    reservations: Reservations
    beside: Mapping[str, Mapping[str, Floats]] = field(default_factory=dict)
    """By parcel the places of those, no part of it, beside which its route begins or ends."""


@dataclass(frozen=True, slots=True)
class Margins:
    """How far parcels are kept apart, and from tipping.

    `clearance_m` is how much every outline is grown by, `gap_s` how long a tile is free between two
    parcels. Unless `off_m` is 0, ways are sought first on which no parcel tips that is so far
    beside them.
    """

    clearance_m: float = 0.01
    gap_s: float = 0.2
    off_m: float = 0.0


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """Settings of the search for routes.

    `step` is how many tiles lattice places are apart. `efforts` are weights of the search
    (`search`), and after how many moves the next effort is made. A route with more than `legs`
    straight ones gets as few as possible past the others (`straightening`).
    """

    step: int = 1
    efforts: tuple[tuple[float, int], ...] = ((1.5, 300), (8.0, MANY))
    legs: int = MANY


#: So many orders of the parcels are tried if the first ones fail.
_TRIES = 6


class Planner:
    """Plans for one table. It keeps its data of a shape, so that the second plan is quick.

    Where it `hangs`, ways may hang over the edge of the table as far as the rim of tiles, else no
    farther than their own ends.
    """

    def __init__(
        self,
        tiles: Tiles,
        pace: Pace | None = None,
        margins: Margins | None = None,
        search: SearchSettings | None = None,
        *,
        hangs: bool = False,
    ) -> None:
        self._margins = margins = margins or Margins()
        self._search = search = search or SearchSettings()
        if tiles.per_pitch % search.step:
            raise ValueError(
                f"places must come alike in every cell: a step of {search.step} tiles does not "
                f"divide the {tiles.per_pitch} of a cell"
            )
        self._ground = Ground(tiles, pace or TrapezoidPace(), margins.clearance_m, hangs)
        self._terms = Terms(self._ground, margins.gap_s, search.efforts)
        self._standings: dict[tuple[Shape, float], ShapeSupport] = {}
        self._ways: dict[tuple[ShapeSupport, tuple[float, ...]], LatticeMoves] = {}

    @property
    def tiles(self) -> Tiles:
        """The tiles of the table."""
        return self._ground.tiles

    def stand(self, shape: Shape, pose: Floats) -> Ints:
        """The tiles that a parcel takes which stands at this pose [m, m, rad; table frame]."""
        return self._ground.stand(shape, pose)

    def plan(
        self,
        tasks: Sequence[RouteTask],
        now_s: float = 0.0,
        *,
        closed: Bools | None = None,
        kept: Mapping[str, Route] | None = None,
    ) -> RoutePlan:
        """Routes for all these parcels, first ones first if that works.

        Tiles that are `closed` are not crossed, but those under a parcel are left. Routes that are
        `kept` are those of other parcels, with their times from now on (`retiming`); they are
        planned around, and part of the plan. The route of a parcel that is planned anew is not
        kept.

        A parcel may stay where a kept route was to pass after it, because it is blocked or has no
        goal any more. Then the parcel of that route is held (`Reservations.held`): it is to be
        stopped and planned anew.
        """
        closed = self._nothing() if closed is None else closed
        named = {task.parcel for task in tasks}
        kept = {name: route for name, route in (kept or {}).items() if name not in named}
        for off_m in dict.fromkeys((self._margins.off_m, 0.0)):
            problems = {task.parcel: self._problem(task, now_s, off_m) for task in tasks}
            plan = self._plan(problems, closed, kept)
            if not plan.blocked:
                break
        return plan

    def _plan(
        self,
        problems: Mapping[str, PlanningProblem],
        closed: Bools,
        kept: Mapping[str, Route],
    ) -> RoutePlan:
        best: dict[str, Route] = {}
        for going, order, sure, aside in self._orders(problems, closed, kept):
            attempt = Attempt(self._terms, going, closed, kept, sure)
            found = attempt.run(order, aside)
            if len(found) >= len(best):
                best = found
            if len(best) == len(order):
                break
        own = {name: best[name] if name in best else problems[name].prefix for name in problems}
        routes = {**kept, **own}
        for name in best:
            if legs_of(routes[name]) > self._search.legs:
                routes[name] = self._straightened(problems[name], routes, closed)
        blocked = {
            name: self._blocked(problems, name, best, closed, kept)
            for name in _moving(problems)
            if name not in best
        }
        return RoutePlan(routes, blocked, (*kept, *best), Reservations(routes))

    def _orders(
        self,
        problems: Mapping[str, PlanningProblem],
        closed: Bools,
        kept: Mapping[str, Route],
    ) -> Iterator[tuple[Mapping[str, PlanningProblem], Sequence[str], bool, Aside]]:
        """Orders of planning: first a well-formed one, then the given one, then random ones.

        Each comes with whether to keep to ways that are sure, as `Attempt` has it, and when others
        go aside for a parcel without a way. If no order works at first, parcels that cannot come to
        their goals at all stay at their places.
        """
        moving = _moving(problems)
        if len(moving) == 1:
            yield problems, moving, True, Aside.NEVER
            yield problems, moving, False, Aside.NEVER
            return
        ends = closed | _ends(kept, closed)
        tried: set[tuple[str, ...]] = set()
        # Where a parcel would tip on its way, that way is no longer there after an attempt.
        while (order := OrderSearch(problems, ends).first()) not in tried:
            if order is not None:
                tried.add(order)
                yield problems, order, True, Aside.NEVER
            elif names := stuck(problems, closed):
                problems = {**problems, **{name: problems[name].staying() for name in names}}
            else:
                break
        moving = _moving(problems)
        yield problems, moving, True, Aside.LATE
        random = Random("orders 1")
        for number in range(_TRIES):
            aside = Aside.EARLY if number % 3 == 0 else Aside.LATE
            yield problems, random.sample(moving, len(moving)), number % 3 < 2, aside

    def _problem(self, task: RouteTask, now_s: float, off_m: float) -> PlanningProblem:
        base_rad = turned_rad(task)
        start, goal = own_ends(task, base_rad)
        yaws_rad = tuple(task.shape.yaws_rad(float(start[2]), float(goal[2])))
        layout = self._ground.tiles.layout
        standing = self._standings.setdefault(
            (task.shape, off_m), ShapeSupport(layout, task.shape, off_m)
        )
        key = standing, yaws_rad
        if key not in self._ways:
            lattice = Lattice(
                self._ground.tiles,
                task.shape,
                yaws_rad,
                self._search.step,
                self._ground.clearance_m,
            )
            self._ways[key] = lattice_moves(lattice, standing, self._ground.pace)
        return PlanningProblem(task, self._ground, self._ways[key], standing, base_rad, now_s)

    def _straightened(
        self, problem: PlanningProblem, routes: Mapping[str, Route], closed: Bools
    ) -> Route:
        """The route of a problem among all others, with fewer legs if it can have them."""
        name, gap_s = problem.task.parcel, self._margins.gap_s
        tiles = TakenTiles(self._ground.tiles.count)
        for owner, (other, route) in enumerate(routes.items()):
            if other != name:
                tile, _, _, enters_s, leaves_s = route.visits
                tiles.take(owner, tile, enters_s - gap_s, leaves_s + gap_s)
        return Straightening(problem, routes[name], tiles.taken, closed).route()

    def kept(
        self, plan: RoutePlan, progress_m: Mapping[str, float], now_s: float
    ) -> dict[str, Route]:
        """The routes of a plan from the parcels' present places, for others to be planned around.

        `progress_m` is without those that are gone. It may have a parcel that is to be planned
        anew. Parcels that waited for it leave it time for its old way, so that it may find one.
        """
        return retimed(plan.reservations, progress_m, now_s, self._ground.pace, self._margins.gap_s)

    def _nothing(self) -> Bools:
        return np.zeros(self._ground.tiles.count, dtype=bool)

    def _blocked(
        self,
        problems: Mapping[str, PlanningProblem],
        name: str,
        routes: Mapping[str, Route],
        closed: Bools,
        kept: Mapping[str, Route],
    ) -> Blocked:
        """Why a parcel has no route: the fewest places that would have to be given up."""
        places: list[tuple[Blocker, Ints]] = []
        for other, its in problems.items():
            if other in routes:
                places.append((Blocker(other, "goal", _end(routes[other])), its.goal_stand))
            elif other != name:
                places.append((Blocker(other, "place", its.task.start), its.stand))
        for other, route in kept.items():
            places.append((Blocker(other, "goal", _end(route)), route.stays))
        own = problems[name]
        by = blockers(places, closed, partial(is_free, own))
        return Blocked(name, own.task.start, own.task.goal, *by)


def _moving(problems: Mapping[str, PlanningProblem]) -> list[str]:
    """The parcels that have goals."""
    return [name for name, problem in problems.items() if problem.task.goal is not None]


def _end(route: Route) -> Floats:
    end: Floats = route.poses[-1]
    return end


def _ends(routes: Mapping[str, Route], nothing: Bools) -> Bools:
    """The tiles on which parcels stay at the ends of routes."""
    ends = np.zeros_like(nothing)
    for route in routes.values():
        ends[route.stays] = True
    return ends


# The first run of an installation -----------------------------------------------------------------


@contextmanager
def planner_compiled_beside() -> Iterator[None]:
    """Have another process compile the planner meanwhile, if its code is not on disk yet.

    A first run compiles the simulator, and then the planner. On two cores it waits half as long.
    """
    if is_kept(interval_search.__name__):
        yield
        return
    code = f"import {__name__} as planner; planner.compile_planner()"
    # With -P no file of the current folder is taken for a module of Python.
    command = [sys.executable, "-P", "-c", code]
    process = Popen(command, stdin=DEVNULL, stdout=DEVNULL, stderr=DEVNULL)
    try:
        yield
    finally:
        process.terminate()
        process.wait()


def compile_planner() -> None:
    """Plan a short way on a small table, which compiles all that every plan needs."""
    start, goal = np.array([-0.05, 0.0, 0.0]), np.array([0.05, 0.0, 0.3])
    task = RouteTask("box", Shape(Rectangle(0.28, 0.28)), start, goal)
    plan = Planner(Tiles(Layout(6, 6))).plan([task])
    plan.reservations.limits_m({"box": 0.0})
