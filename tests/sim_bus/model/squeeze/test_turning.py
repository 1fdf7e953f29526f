"""Polygons turn to where their halves' centroids are one behind the other, and nowhere else."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.sim_bus.model.squeeze.continuous import GRID, energy, slides
from tests.sim_bus.model.squeeze.polygons import (
    IRREGULAR,
    RECTANGLE,
    SQUARE,
    TRIANGLE,
    polygons,
    regular,
)

from mdms_model.squeeze import Bisectors, alike_turns, squeeze_function


@settings(max_examples=20, deadline=None)
@given(polygons(), st.floats(0.0, 1.0))
def test_slope_and_energy_of_a_bisector_are_those_of_halves_cut_out(corners, share):
    bisectors = Bisectors(corners)
    polygon = shapely.Polygon(bisectors.corners)
    assert polygon.area == pytest.approx(1.0)
    found = bisectors.at(share * len(corners))
    assert found.energy == pytest.approx(energy(polygon, found.angle_rad), abs=1e-6)
    ahead, behind = (energy(polygon, found.angle_rad + turn) for turn in (1e-3, -1e-3))
    assert found.slope == pytest.approx((ahead - behind) / 2e-3, abs=1e-4)


def test_a_rectangle_rests_with_its_long_sides_along_the_line():
    function = squeeze_function(RECTANGLE)
    assert function.stable_rad == pytest.approx([np.pi / 2])
    assert function.unstable_rad == pytest.approx([0.0], abs=1e-9)
    assert function.period_rad == pytest.approx(np.pi)


def test_a_square_rests_on_its_diagonals():
    function = squeeze_function(SQUARE)
    assert function.period_rad == pytest.approx(np.pi / 2)
    assert np.mod(function.stable_rad, np.pi / 2) == pytest.approx([np.pi / 4])


@pytest.mark.parametrize(
    ("count", "period_deg"), [(3, 60), (4, 90), (5, 36), (6, 60), (7, 180 / 7)]
)
def test_a_regular_polygon_is_known_up_to_the_turns_that_it_and_the_field_share(count, period_deg):
    function = squeeze_function(regular(count))
    assert np.degrees(function.period_rad) == pytest.approx(period_deg)
    assert len(function.stable_rad) == 1
    assert alike_turns(regular(count)) == count


@pytest.mark.parametrize(
    ("corners", "turns"), [(RECTANGLE, 2), (SQUARE, 4), (TRIANGLE, 1), (IRREGULAR, 1)]
)
def test_how_often_a_polygon_looks_the_same_in_a_turn(corners, turns):
    assert alike_turns(corners + np.array([0.3, -0.2])) == turns


@pytest.mark.parametrize("corners", [RECTANGLE, TRIANGLE, IRREGULAR, regular(5) * [1.0, 0.97]])
def test_every_angle_goes_where_its_energy_falls_to(corners):
    function, ends = squeeze_function(corners), slides(corners)
    step = np.pi / GRID
    near_deg = 3.0
    for start, end in enumerate(ends):
        edges = np.array(function.unstable_rad)
        apart = (start * step - edges + np.pi / 2) % np.pi - np.pi / 2
        # Where the energy is flat, steps of a grid may stop, or fall to the other side.
        if np.degrees(np.abs(apart)).min() > near_deg:
            assert function(start * step) == pytest.approx(end * step, abs=np.radians(near_deg))


@settings(max_examples=60, deadline=None)
@given(polygons(), st.floats(-10.0, 10.0))
def test_a_second_squeeze_changes_nothing_and_no_angle_passes_another(corners, angle):
    function = squeeze_function(corners)
    rest = function(angle)
    assert function(rest) == pytest.approx(rest, abs=1e-9)
    assert function.turn(rest) == 0 or abs(function(rest) - rest) < 1e-9
    assert function(angle + function.period_rad) == pytest.approx(rest + function.period_rad)
    assert function(angle + 0.01) >= rest - 1e-9
    assert function.turn(angle) == np.sign(rest - angle)
    low, high = np.array(function.unstable_rad), np.array(function.stable_rad)
    assert (low < high).all()
    assert (high[:-1] < low[1:]).all()


@settings(max_examples=30, deadline=None)
@given(polygons(), st.floats(0.01, 100.0), st.floats(-3.0, 3.0), st.floats(-5.0, 5.0))
def test_size_and_place_do_not_matter_and_turning_the_polygon_turns_all(corners, size, turn, away):
    function = squeeze_function(corners)
    turned = corners @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    other = squeeze_function(size * (turned + away))
    assert other.period_rad == pytest.approx(function.period_rad)
    period = function.period_rad
    for angle in function.stable_rad:
        assert other(angle + turn) == pytest.approx(angle + turn, abs=1e-5), period


def test_a_polygon_that_is_nearly_a_disc_is_known_up_to_a_few_degrees_only():
    assert np.degrees(squeeze_function(regular(60)).period_rad) == pytest.approx(6.0)
