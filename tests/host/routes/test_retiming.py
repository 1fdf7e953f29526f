"""One parcel is planned anew among the others, which keep their routes and their order."""

from itertools import pairwise
from math import pi

import numpy as np
import pytest
from tests.host.routes.parcels import task

from mdms_host.layout import Layout
from mdms_host.routes.grid import Tiles
from mdms_host.routes.planner import Planner


@pytest.fixture(scope="module")
def planner() -> Planner:
    return Planner(Tiles(Layout(9, 6)))


def test_a_route_that_keeps_to_its_times_is_left_as_it_was(planner: Planner) -> None:
    plan = planner.plan(crossing())
    kept = planner.kept(plan, {"a": 0.0, "b": 0.0}, 0.0)
    for name, route in kept.items():
        assert np.allclose(route.arrives_s, plan.routes[name].arrives_s, atol=0.01)


def test_a_parcel_that_waits_for_a_late_one_is_late_as_well(planner: Planner) -> None:
    plan = planner.plan(crossing())
    first, second = plan.order
    kept = planner.kept(plan, {first: 0.0, second: 0.0}, 3.0)
    late_s = kept[second].end_s - plan.routes[second].end_s
    assert late_s == pytest.approx(3.0, abs=0.05)


def test_planned_times_are_known_however_often_a_route_is_planned_around(planner: Planner) -> None:
    plan = planner.plan([task("a", (-0.4, -0.2, 0.0), (0.4, 0.2, pi / 2))])
    along_m = plan.routes["a"].along_m
    for now_s in (1.5, 1.8):
        progress_m = along_m[1] + now_s * 0.1
        kept = planner.kept(plan, {"a": progress_m}, now_s)
        plan = planner.plan([task("b", (0.0, -0.3, 0.0), (0.1, -0.3, 0.0))], now_s, kept=kept)
        due_s = plan.routes["a"].ahead_s(progress_m, along_m[-1])
        assert np.isfinite(due_s).all()
        assert due_s[0] <= now_s < due_s[-1]


def test_one_that_was_set_down_close_to_another_waits_for_nobody(planner: Planner) -> None:
    at_goal = (0.38, 0.0, 0.0)
    others = planner.plan([task("b", (0.06, -0.22, 0.0), (0.0, 0.22, 0.0))])
    kept = planner.kept(others, {"b": 0.0}, 0.0)
    plan = planner.plan([task("a", at_goal, at_goal)], 0.0, kept=kept)
    again = planner.kept(plan, {"a": 0.0, "b": 0.0}, 1.0)
    assert again["a"].length_m == 0.0
    assert again["b"].end_s > kept["b"].end_s


def test_a_goal_that_changes_is_planned_around_the_others(planner: Planner) -> None:
    plan = planner.plan(crossing())
    first, second = plan.order
    progress_m = {first: 0.3}
    kept = planner.kept(plan, progress_m, 1.5)
    at = plan.routes[second].poses[0]
    again = planner.plan([task(second, tuple(at), (0.0, -0.2, 0.0))], 1.5, kept=kept)
    assert not again.blocked
    assert again.routes[first].length_m == plan.routes[first].length_m
    taken = {tile: visits for tile, visits in again.reservations.order.items() if len(visits) > 1}
    for visits in taken.values():
        for former, later in pairwise(visits):
            assert former.leaves_s <= later.enters_s


def test_a_kept_route_over_the_place_of_one_that_is_blocked_is_held(planner: Planner) -> None:
    plan = planner.plan(crossing())
    first, second = plan.order
    at = plan.routes[first].poses[0]
    kept = planner.kept(plan, {second: 0.0}, 0.0)
    again = planner.plan([task(first, tuple(at), (0.0, 0.9, 0.0))], kept=kept)
    assert set(again.blocked) == {first}
    assert held(again) == {second}
    free = planner.plan([task(first, (0.4, -0.2, 0.0), (0.4, -0.22, 0.0))], kept=kept)
    assert not held(free)


def test_the_parcel_that_was_to_pass_first_finds_a_way_again_before_others_close_it() -> None:
    planner = Planner(Tiles(Layout(15, 8)))
    closed = np.zeros(planner.tiles.count, dtype=bool)
    for row in (0, 1, 2, 6, 7):
        closed[planner.tiles.of_cell(row * 15 + 8)] = True
    far = task("far", (-0.7, -0.3, 0.0), (0.6, 0.06, 0.0))
    near = task("near", (-0.5, 0.35, 0.0), (0.0, 0.06, 0.0))
    plan = planner.plan([far, near], closed=closed)
    kept = planner.kept(plan, {"far": 0.0, "near": 0.0}, 0.0)
    again = planner.plan([far], closed=closed, kept=kept)
    assert not again.blocked
    assert again.routes["far"].end_s == pytest.approx(plan.routes["far"].end_s, abs=0.1)
    alone = planner.kept(plan, {"near": 0.0}, 0.0)
    assert planner.plan([far], closed=closed, kept=alone).blocked


def held(plan):
    return plan.reservations.held(dict.fromkeys(plan.routes, 0.0), plan.routes.keys() - plan.order)


def crossing() -> list:
    return [
        task("a", (-0.4, 0.2, 0.0), (0.4, 0.2, 0.0)),
        task("b", (0.4, 0.15, 0.0), (-0.4, -0.2, 0.0)),
    ]
