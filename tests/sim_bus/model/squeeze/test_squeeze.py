"""Squeeze functions of polygons, and plans of squeezes."""

from itertools import product

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.sim_bus.model.squeeze.continuous import GRID, energy, slides, squeezed_yaws
from tests.sim_bus.model.squeeze.polygons import (
    IRREGULAR,
    RECTANGLE,
    SQUARE,
    TRIANGLE,
    polygons,
    regular,
)

from mdms_model.squeeze import (
    Bisectors,
    SqueezeFunction,
    alike_turns,
    plan_squeezes,
    squeeze_function,
)


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


YAWS_RAD = np.arange(720) * np.pi / 360 + 1e-3
UNEVEN = regular(8) * [1.0, 0.93] + 0.02 * np.sin(np.arange(16)).reshape(8, 2)


def apart(yaws_rad, yaw_rad, period_rad):
    return np.abs((np.asarray(yaws_rad) - yaw_rad + period_rad / 2) % period_rad - period_rad / 2)


@pytest.mark.parametrize(
    "corners", [RECTANGLE, SQUARE, TRIANGLE, IRREGULAR, UNEVEN, regular(3) * [1.0, 1.05]]
)
def test_the_plan_holds_from_720_angles_in_a_field_cut_out_by_brute_force(corners):
    plan = plan_squeezes(squeeze_function(corners))
    headings = [step.heading_rad for step in plan.steps]
    yaws = squeezed_yaws(corners, headings, YAWS_RAD)
    off = apart(yaws, plan.yaw_rad, plan.function.period_rad)
    # A brute force on a grid hangs where the energy is flat, as it is about unstable angles.
    assert np.mean(off < np.radians(1.5)) > 0.985


@settings(max_examples=40, deadline=None)
@given(polygons())
def test_any_polygon_is_oriented_from_any_angle_in_at_most_two_squeezes_a_side(corners):
    plan = plan_squeezes(squeeze_function(corners))
    assert len(plan.steps) <= 2 * len(corners)
    yaws = YAWS_RAD[::12].tolist()
    for number, step in enumerate(plan.steps):
        yaws = [plan.predict(yaw, number) for yaw in yaws]
        for yaw in yaws:
            assert min(apart(step.yaws_rad, yaw, plan.function.period_rad)) < 1e-6
    assert max(apart(yaws, plan.yaw_rad, plan.function.period_rad)) < 1e-6


def test_steps_keep_their_margin_from_angles_that_turn_the_other_way():
    plan = plan_squeezes(squeeze_function(TRIANGLE))
    assert len(plan.steps) == 3
    assert np.degrees(plan.margin_rad) == pytest.approx(20.5, abs=0.1)
    for before, step in zip(plan.steps[:-1], plan.steps[1:], strict=True):
        for yaw in before.yaws_rad:
            for off in (-0.99, 0.99):
                after = plan.predict(yaw + off * step.margin_rad, plan.steps.index(step))
                assert min(apart(step.yaws_rad, after, plan.function.period_rad)) < 1e-9


def shortest(function, steps):
    """The least number of squeezes, by trying all turns of a fine grid, up to so many."""
    turns = np.linspace(0.0, function.period_rad, 60, endpoint=False)
    for count in range(1, steps + 1):
        for course in product(turns, repeat=count - 1):
            angles = {round(angle, 9) for angle in function.stable_rad}
            for turn in course:
                angles = {
                    round(function(angle + turn) % function.period_rad, 9) for angle in angles
                }
            if len(angles) == 1:
                return count
    return None


@pytest.mark.parametrize("corners", [RECTANGLE, TRIANGLE, IRREGULAR, UNEVEN])
def test_no_shorter_plan_exists(corners):
    function = squeeze_function(corners)
    plan = plan_squeezes(function)
    assert shortest(function, len(plan.steps)) == len(plan.steps)


def test_basins_of_many_widths_take_as_many_steps_as_trying_all_turns_finds():
    function = SqueezeFunction(
        np.pi, stable_rad=(0.1, 0.8, 1.9, 2.9), unstable_rad=(0.0, 0.5, 1.2, 2.6)
    )
    assert len(plan_squeezes(function).steps) == shortest(function, 4)


def test_the_plan_ends_at_the_yaw_that_is_wanted():
    function = squeeze_function(TRIANGLE)
    plan = plan_squeezes(function, final_yaw_rad=0.7)
    assert plan.yaw_rad == pytest.approx(0.7)
    free = plan_squeezes(function)
    turns = {
        round((a.heading_rad - b.heading_rad) % np.pi, 6)
        for a, b in zip(plan.steps, free.steps, strict=True)
    }
    assert len(turns) == 1
    yaws = squeezed_yaws(TRIANGLE, [step.heading_rad for step in plan.steps], YAWS_RAD)
    assert np.mean(apart(yaws, 0.7, np.pi) < np.radians(1.5)) > 0.985


def test_the_first_squeeze_is_onto_a_line_along_x():
    assert plan_squeezes(squeeze_function(IRREGULAR)).steps[0].heading_rad == pytest.approx(0.0)
