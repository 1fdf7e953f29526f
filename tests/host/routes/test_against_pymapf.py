"""On a grid, with bodies of a cell and moves of a cell a second, an independent planner agrees."""

from itertools import product
from random import Random

import numpy as np
import pytest
from pymapf import Agent, ConflictBasedSearch, GridMap, MAPFProblem, space_time_astar

from mdms_host.estimation.footprint import Rectangle
from mdms_host.layout import Layout, WheelPlace
from mdms_host.routes.grid import Tiles
from mdms_host.routes.planner import Margins, Planner, SearchSettings
from mdms_host.routes.planning_problem import RouteTask
from mdms_host.routes.support import Shape
from mdms_model.arrays import Floats

SIDE = 5
#: A cell's body, a hair smaller than the cell.
BODY = Shape(Rectangle(1.0 - 1e-5, 1.0 - 1e-5))
WHEELS = tuple(WheelPlace(0.0, (x_m, y_m)) for x_m, y_m in product((-0.45, 0.0, 0.45), repeat=2))
Cell = tuple[int, int]


class GridPace:
    """One cell a second along rows and columns; any other move takes so long that none is made."""

    def times_s(self, lengths_m: Floats, turns_m: Floats, shares: Floats) -> Floats:
        along = (np.abs(lengths_m - np.round(lengths_m)) < 1e-6) & (lengths_m < SIDE - 0.5)
        return np.where(along, 1.0, 100.0) * lengths_m * shares


@pytest.fixture(scope="module")
def planner() -> Planner:
    tiles = Tiles(Layout(SIDE, SIDE, 1.0, wheels=WHEELS), 1)
    search = SearchSettings(efforts=((1.0, 2**31),))
    return Planner(tiles, GridPace(), Margins(0.0, 0.0), search)


@pytest.mark.parametrize("seed", range(20))
def test_one_parcel_among_obstacles_takes_as_long(planner: Planner, seed: int) -> None:
    random = Random(f"one {seed}")
    start, goal, *walls = random.sample(cells(), 9)
    grid = GridMap([[(row, column) in walls for column in range(SIDE)] for row in range(SIDE)])
    path = space_time_astar(grid, start, goal)
    closed = np.zeros(planner.tiles.count, dtype=bool)
    for row, column in walls:
        closed[planner.tiles.of_cell(row * SIDE + column + 1)] = True
    plan = planner.plan([task("a", start, goal)], closed=closed)
    assert bool(plan.blocked) == (path is None)
    if path is not None:
        assert plan.routes["a"].end_s == pytest.approx(len(path) - 1, abs=1e-3)


@pytest.mark.parametrize("seed", range(20))
def test_no_plan_is_better_than_the_best_and_few_are_much_worse(
    planner: Planner, seed: int
) -> None:
    random = Random(f"three {seed}")
    places = random.sample(cells(), 6)
    pairs = dict(zip("abc", zip(places[:3], places[3:], strict=True), strict=True))
    problem = MAPFProblem(
        GridMap([[False] * SIDE] * SIDE), [Agent(name, *pair) for name, pair in pairs.items()]
    )
    best = ConflictBasedSearch().solve(problem)
    plan = planner.plan([task(name, *pair) for name, pair in pairs.items()])
    assert not plan.blocked
    ends_s = [max(route.end_s, 0.0) for route in plan.routes.values()]
    assert sum(ends_s) >= best.sum_of_costs - 1e-3
    # A tile that one leaves is free when it has left it, not when it begins to: hence some more.
    assert sum(ends_s) <= 1.5 * best.sum_of_costs + 1e-3


def cells() -> list[Cell]:
    return list(product(range(SIDE), repeat=2))


def task(name: str, start: Cell, goal: Cell) -> RouteTask:
    return RouteTask(name, BODY, pose(start), pose(goal))


def pose(cell: Cell) -> Floats:
    row, column = cell
    return np.array([column - (SIDE - 1) / 2, row - (SIDE - 1) / 2, 0.0])
