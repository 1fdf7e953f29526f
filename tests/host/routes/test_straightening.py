"""Corners of routes are left out that neither others nor the footing ask for."""

import numpy as np
from tests.benchmarks.host._route_instances import instance
from tests.benchmarks.host._route_outlines import faults
from tests.benchmarks.host.legs import CellsTable
from tests.benchmarks.host.routes import held
from tests.host.motion.driving import LAYOUT
from tests.host.routes.parcels import BOX, task

from mdms_host.estimation.footprint import Rectangle
from mdms_host.layout import Layout
from mdms_host.motion.footholds import MARGIN_M
from mdms_host.routes.grid import Tiles
from mdms_host.routes.improving import legs_of
from mdms_host.routes.planner import Planner, SearchSettings
from mdms_host.routes.support import Shape, ShapeSupport

#: Tables on which every route of more than one leg is given as few as it can have, and none is.
STRAIGHT, WINDING = CellsTable(9, 6, 3, 1, legs=1), CellsTable(9, 6, 3, 1, legs=2**31)


def test_routes_have_fewer_legs_and_all_arrive_and_none_touch() -> None:
    legs = before = 0
    for seed in range(8):
        tasks = instance(STRAIGHT, seed)
        plan = STRAIGHT.planner.plan(tasks)
        assert not faults(STRAIGHT.size_m, tasks, plan), f"seed {seed}"
        assert not held(plan), f"seed {seed}"
        legs += sum(map(legs_of, plan.routes.values()))
        before += sum(map(legs_of, WINDING.planner.plan(tasks).routes.values()))
    assert legs < before


def test_a_route_is_over_no_later_than_it_was() -> None:
    tasks = instance(STRAIGHT, 47)
    plan, before = STRAIGHT.planner.plan(tasks), WINDING.planner.plan(tasks)
    assert legs_of(before.routes["parcel 1"]) > 6 > legs_of(plan.routes["parcel 1"])
    for name, route in plan.routes.items():
        assert route.end_s <= before.routes[name].end_s + 1e-9
        assert np.allclose(route.poses[[0, -1]], before.routes[name].poses[[0, -1]])


def test_routes_of_few_legs_are_left_as_they_were() -> None:
    tasks = instance(STRAIGHT, 19)
    plan = CellsTable(9, 6, 3, 1, legs=6).planner.plan(tasks)
    before = WINDING.planner.plan(tasks)
    fewer = {name: legs_of(route) for name, route in plan.routes.items()}
    for name, route in before.routes.items():
        if legs_of(route) > 6:
            assert fewer[name] <= 6
        else:
            assert np.array_equal(plan.routes[name].poses, route.poses)


def test_no_corner_is_cut_over_a_tile_that_is_closed() -> None:
    planner = Planner(Tiles(Layout(7, 4), 1), search=SearchSettings(legs=1))
    closed = np.zeros(planner.tiles.count, dtype=bool)
    closed[planner.tiles.of_cell(25)] = True
    around = task("box", (-0.22, 0.08, 0.0), (0.22, 0.08, 0.0))
    route = planner.plan([around], closed=closed).routes["box"]
    assert legs_of(route) > 1
    assert not closed[route.visits.tile].any()
    assert legs_of(planner.plan([around]).routes["box"]) == 1


def test_no_corner_is_cut_where_the_parcel_might_tip() -> None:
    small = Shape(Rectangle(0.28, 0.22))
    start, goal = (0.05, 0.02, 0.13), (-0.08, -0.01, 2.65)
    standing = ShapeSupport(LAYOUT, small)
    assert standing.least_margin_m(np.array(start), np.array(goal)) < MARGIN_M
    box = task("box", start, goal, small)
    before = Planner(Tiles(LAYOUT, 1)).plan([box]).routes["box"]
    route = Planner(Tiles(LAYOUT, 1), search=SearchSettings(legs=1)).plan([box]).routes["box"]
    assert legs_of(before) > legs_of(route) > 1
    for one, other in zip(route.poses, route.poses[1:], strict=False):
        assert standing.least_margin_m(one, other) >= MARGIN_M - 1e-6


def test_a_leg_on_which_a_parcel_rests_is_one_leg() -> None:
    plan = Planner(Tiles(Layout(9, 6), 1)).plan([task("a", (-0.4, 0.0, 0.0), (0.4, 0.0, 0.0), BOX)])
    assert legs_of(plan.routes["a"]) == 1
