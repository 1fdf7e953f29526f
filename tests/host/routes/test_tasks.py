"""Parcels that leave, that are under way when they are planned, and cells that are closed."""

import os
import subprocess
import sys

import numpy as np
import pytest
from tests.host.routes.parcels import BOX, task

from mdms_host.layout import Layout
from mdms_host.routes.grid import Tiles
from mdms_host.routes.planner import Planner
from mdms_host.routes.planning_problem import RouteTask

PLANNED = """
import numpy as np
from mdms_host.estimation.footprint import Rectangle
from mdms_host.layout import Layout
from mdms_host.routes.planning_problem import RouteTask
from mdms_host.routes.planner import Planner
from mdms_host.routes.support import Shape
from mdms_host.routes.grid import Tiles

box = Shape(Rectangle(0.28, 0.28))
ends = {"a": ((-0.2, 0.15, 0.0), (0.2, 0.15, 0.0)), "b": ((0.2, -0.15, 0.0), (-0.2, -0.15, 0.1))}
tasks = [RouteTask(n, box, np.array(start), np.array(goal)) for n, (start, goal) in ends.items()]
for route in Planner(Tiles(Layout(6, 5), 1)).plan(tasks).routes.values():
    print(route.poses.round(6).tolist(), route.begins_s.round(6).tolist())
"""


@pytest.fixture(scope="module")
def planner() -> Planner:
    return Planner(Tiles(Layout(9, 6)))


def test_a_leaving_parcel_is_in_nobodys_way_at_its_goal(planner: Planner) -> None:
    leaving = RouteTask("a", BOX, np.array([0.1, 0.0, 0.0]), np.array([0.56, 0.0, 0.0]), True, 0.5)
    plan = planner.plan([leaving, task("b", (-0.4, 0.0, 0.0), (0.4, 0.0, 0.0))])
    assert not plan.blocked
    assert not plan.routes["a"].stays.size
    both = [visits for visits in plan.reservations.order.values() if len(visits) == 2]
    assert both
    for former, later in both:
        assert (former.parcel, later.parcel) == ("a", "b")
        assert former.leaves_s < later.enters_s
    assert plan.reservations.limits_m({"b": 0.0}) == {"b": plan.routes["b"].length_m}


def test_closed_cells_are_not_crossed_and_may_cut_the_table(planner: Planner) -> None:
    tasks = [task("a", (-0.4, 0.0, 0.0), (0.4, 0.0, 0.0))]
    closed = closed_cells(planner, [5, 14])
    plan = planner.plan(tasks, closed=closed)
    assert not plan.blocked
    assert not closed[plan.routes["a"].visits.tile].any()
    plan = planner.plan(tasks, closed=closed_cells(planner, range(5, 55, 9)))
    assert plan.blocked["a"].closed


def test_a_parcel_on_a_closed_cell_leaves_it(planner: Planner) -> None:
    plan = planner.plan(
        [task("a", (-0.2, 0.0, 0.0), (0.3, 0.0, 0.0))], closed=closed_cells(planner, [21])
    )
    assert not plan.blocked


def test_tiles_of_a_whole_cell_do_as_well() -> None:
    planner = Planner(Tiles(Layout(9, 6), 1))
    tasks = [
        task("a", (-0.38, 0.19, 0.0), (0.38, 0.19, 0.0)),
        task("b", (0.38, -0.19, 0.0), (-0.38, -0.19, 0.0)),
    ]
    plan = planner.plan(tasks)
    assert not plan.blocked
    assert all(np.allclose(plan.routes[each.parcel].poses[-1], each.goal) for each in tasks)


def test_plans_are_the_same_without_numba() -> None:
    poses = [printed_poses(disable_jit) for disable_jit in ("0", "1")]
    assert poses[0] == poses[1]
    assert "[" in poses[0]


def printed_poses(disable_jit: str) -> str:
    """Poses and times of routes that another process plans, with or without compiled functions."""
    run = subprocess.run(
        [sys.executable, "-c", PLANNED],
        env={**os.environ, "NUMBA_DISABLE_JIT": disable_jit},
        capture_output=True,
        text=True,
        check=True,
    )
    return run.stdout


def closed_cells(planner: Planner, cells) -> np.ndarray:
    closed = np.zeros(planner.tiles.count, dtype=bool)
    for cell in cells:
        closed[planner.tiles.of_cell(cell)] = True
    return closed
