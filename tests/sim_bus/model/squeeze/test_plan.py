"""A plan brings a polygon from any angle to one, with no step too many."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from tests.sim_bus.model.squeeze.continuous import squeezed_yaws
from tests.sim_bus.model.squeeze.polygons import (
    IRREGULAR,
    RECTANGLE,
    SQUARE,
    TRIANGLE,
    polygons,
    regular,
)

from mdms_model.squeeze import SqueezeFunction, plan_squeezes, squeeze_function

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
