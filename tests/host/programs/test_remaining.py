"""What is left of routes: tiles to come, when, and in which order."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest

from mdms_host.programs.remaining import remaining
from mdms_host.routes.pace import TrapezoidPace
from mdms_host.routes.reservations import Wait
from mdms_host.routes.route import Route, Visits

#: As fast as it gets at once: a metre takes 2 s.
PACE = TrapezoidPace(0.5, 1e6)


def route(name, *, gone=False):
    """One metre along x, over tiles 0 to 3 of 0.25 m."""
    along_m = np.arange(4) * 0.25
    visits = Visits(np.arange(4), along_m, along_m + 0.25, along_m * 2, along_m * 2 + 0.5)
    visits.leaves_m[-1] = visits.leaves_s[-1] = inf
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    along = np.array([0.0, 1.0])
    return Route(name, poses, along, np.zeros(1), np.full(1, 2.0), visits, 0.2, gone)


def left_of(routes, progress_m, waits=None, now_s=10.0):
    routes = {one.parcel: one for one in routes}
    return remaining(routes, progress_m, waits or {}, PACE, now_s=now_s, gone_s=0.3)


def test_tiles_that_a_parcel_has_left_are_free_and_those_under_it_are_its_own():
    visits = left_of([route("a")], {"a": 0.6})["a"].visits
    assert visits.tile.tolist() == [2, 3]
    assert visits.enters_s.tolist() == [-inf, pytest.approx(10.3)]
    assert visits.leaves_s.tolist() == [pytest.approx(10.3), inf]


def test_a_parcel_that_leaves_the_table_is_gone_a_while_after_its_end():
    visits = left_of([route("a", gone=True)], {"a": 0.5})["a"].visits
    assert visits.leaves_s[-1] == pytest.approx(10.0 + 1.0 + 0.3)
    visits = left_of([route("a", gone=True)], {"a": 1.2})["a"].visits
    assert visits.tile.tolist() == [3]
    assert visits.leaves_s.tolist() == [pytest.approx(10.3)]


def test_whoever_waits_is_as_late_as_whom_it_waits_for_and_the_order_stays():
    ahead, behind = route("ahead"), route("behind")
    waits = {"behind": (Wait(0.25, "ahead", 0.75),)}
    left = left_of([behind, ahead], {"ahead": 0.1, "behind": 0.0}, waits)
    assert left["ahead"].visits.leaves_s[2] == pytest.approx(11.3)
    assert left["behind"].visits.enters_s.tolist() == [
        -inf,
        pytest.approx(10.5),
        pytest.approx(12.3 - 0.5),
        pytest.approx(12.3),
    ]


def test_a_chain_of_waits_is_passed_on():
    routes = [route(name) for name in ("c", "b", "a")]
    waits = {"b": (Wait(0.5, "a", 0.75),), "c": (Wait(0.5, "b", 0.75),)}
    left = left_of(routes, {"a": 0.0, "b": 0.25, "c": 0.25}, waits)
    assert left["b"].visits.enters_s[-1] == pytest.approx(11.5 + 0.5)
    assert left["c"].visits.enters_s[-1] == pytest.approx(12.0 + 0.5)


def test_a_route_keeps_its_way():
    one = route("a")
    left = left_of([one], {"a": 0.3})["a"]
    assert replace(left, visits=one.visits) == one
