"""A parcel that keeps to its authority meets no other, and no parcel holds it up for ever."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.host.routes.parcels import LONG, task

from mdms_host.layout import Layout
from mdms_host.routes.grid import Tiles
from mdms_host.routes.planner import Planner, RoutePlan
from mdms_host.routes.reservations import REST_M, Reservations
from mdms_host.routes.route import Visits


@pytest.fixture(scope="module")
def plan() -> RoutePlan:
    """Four parcels that all cross each other's way; one of them has to stand aside."""
    planner = Planner(Tiles(Layout(14, 9)))
    return planner.plan(
        [
            task("a", (-0.6, 0.38, 0.0), (0.6, 0.38, 0.0)),
            task("b", (0.6, 0.38, 0.0), (-0.6, 0.38, 0.0), LONG),
            task("c", (-0.6, -0.35, 0.0), (0.6, -0.3, np.pi / 2)),
            task("d", (0.6, -0.35, 0.0), (-0.6, 0.0, 0.0), LONG),
        ]
    )


def test_planned_visits_of_a_tile_do_not_overlap(plan: RoutePlan) -> None:
    assert not plan.blocked
    for visits in plan.reservations.order.values():
        for former, later in pairwise(visits):
            assert former.parcel == later.parcel or former.leaves_s < later.enters_s


def test_parcel_that_has_left_all_its_tiles_waits_for_nobody(plan: RoutePlan) -> None:
    route = plan.routes["a"]
    left = replace(route, visits=Visits(*(column[:0] for column in route.visits)))
    assert Reservations({"a": left}).waits == {"a": ()}


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_all_arrive_and_no_tile_has_two_however_late_anybody_is(plan: RoutePlan, seed: int) -> None:
    random = np.random.default_rng(seed)
    routes = plan.routes
    progress_m = dict.fromkeys(routes, 0.0)
    for _ in range(5000):
        limits_m = plan.reservations.limits_m(progress_m)
        moved = False
        for name in random.permutation(list(routes)).tolist():
            # It stops before its limit, and at the poses of its route, a little too early.
            short_m = random.uniform(0.0, REST_M)
            stop_m = min(limits_m[name], random.choice([0.03, 0.2, np.inf]) + progress_m[name])
            if stop_m - short_m > progress_m[name]:
                progress_m[name], moved = stop_m - short_m, True
        assert_one_a_tile(plan, progress_m)
        there = all(progress_m[name] >= route.length_m - REST_M for name, route in routes.items())
        if there:
            return
        if not moved:
            assert any(limits_m[name] - progress_m[name] > REST_M for name in routes), progress_m
    pytest.fail(f"they did not arrive: {progress_m}")


def test_a_parcel_that_is_gone_keeps_nobody_waiting(plan: RoutePlan) -> None:
    last = plan.order[-1]
    length_m = plan.routes[last].length_m
    assert plan.reservations.limits_m(dict.fromkeys(plan.routes, 0.0))[last] < length_m
    assert plan.reservations.limits_m({last: 0.0}) == {last: length_m}


def assert_one_a_tile(plan: RoutePlan, progress_m: dict[str, float]) -> None:
    for tile, visits in plan.reservations.order.items():
        on_it = {
            visit.parcel
            for visit in visits
            if visit.enters_m < progress_m[visit.parcel] < visit.leaves_m - REST_M
        }
        assert len(on_it) <= 1, f"{on_it} are on tile {tile} at {progress_m}"
