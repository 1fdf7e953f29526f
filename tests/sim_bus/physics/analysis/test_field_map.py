from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mdms_model.array import build_wheels
from mdms_model.motor import drive_of
from mdms_model.parcel import held_parcel
from mdms_model.scenario.scenario import Array, Cell, Parcel, Scenario, Wheel
from mdms_sim.physics.field_map import (
    Law,
    Stability,
    held_force,
    map_field,
    place_rests,
    running_wheels_of,
    settle,
    turn_rests,
)
from mdms_sim.physics.row_laws import sliding_law

PITCH_M = 0.127
BOX = Parcel("box", 2.0, 0.36, 0.30)
ROW_BOX = Parcel("box", 2.0, 0.4445, 0.1)


def plane(parcel=BOX, offset_m=0.0, **cell):
    wheels = (Wheel(0.0, (-offset_m, 0.0)), Wheel(np.pi / 2, (offset_m, 0.0)))
    return Scenario("plane", Array(6, 3), Cell(wheel=wheels, **cell), (parcel,))


def row(**cell):
    return Scenario("row", Array(10, 1), Cell(**cell), (ROW_BOX,))


def inward(scenario, speed_m_s):
    wheels = build_wheels(scenario)
    return -speed_m_s * (np.sign(wheels.position_m) * wheels.direction).sum(axis=1)


def mapped(scenario, reference_m_s, law=Law.SLIDING):
    return map_field(scenario, scenario.parcel[0], reference_m_s, law)


@given(
    x_m=st.floats(-0.1, 0.1),
    y_m=st.floats(-0.05, 0.05),
    yaw_rad=st.floats(-3.0, 3.0),
    seed=st.integers(0, 99),
)
def test_held_parcel_feels_the_friction_of_least_squares_loads(x_m, y_m, yaw_rad, seed):
    scenario = plane(offset_m=0.03)
    wheels = build_wheels(scenario)
    reference_m_s = np.random.default_rng(seed).normal(size=len(wheels.position_m))
    table = running_wheels_of(scenario, reference_m_s, Law.SLIDING)
    found = held_force(table, held_parcel(scenario, BOX), x_m, y_m, yaw_rad)
    arm_m = wheels.position_m - (x_m, y_m)
    own_m = arm_m @ np.array(
        [[np.cos(yaw_rad), -np.sin(yaw_rad)], [np.sin(yaw_rad), np.cos(yaw_rad)]]
    )
    under = (abs(own_m) <= (0.18, 0.15)).all(axis=1)
    matrix = np.vstack([np.ones(under.sum()), arm_m[under].T])
    normal_n = np.linalg.lstsq(matrix, [2.0 * 9.81, 0.0, 0.0], rcond=None)[0]
    if normal_n.min() < 0.0:
        return
    pushes = (0.3 * normal_n * np.sign(reference_m_s[under]))[:, None] * wheels.direction[under]
    torque = (arm_m[under, 0] * pushes[:, 1] - arm_m[under, 1] * pushes[:, 0]).sum()
    assert found == pytest.approx([*pushes.sum(axis=0), torque], abs=1e-6)


def test_row_that_slides_is_held_at_the_origin_by_the_paper_spring():
    scenario = row()
    reference_m_s = inward(scenario, 10.0)
    field = mapped(scenario, reference_m_s)
    (rest,) = field.places
    middle, weight_n = slice(3, 7), ROW_BOX.mass_kg * scenario.run.gravity_m_s2
    wheel_x_m = build_wheels(scenario).position_m[middle, 0]
    law = sliding_law(wheel_x_m, reference_m_s[middle], scenario.cell.friction, weight_n)
    assert rest.kind is Stability.STABLE
    assert rest.x_m == pytest.approx(0.0, abs=1e-9)
    assert rest.stiffness_n_per_m[0].real == pytest.approx(law.spring_n_per_m)


def test_row_that_rolls_rests_anywhere_while_equally_many_wheels_push_both_ways():
    field = mapped(row(), inward(row(), 0.0635), Law.AT_REST)
    force_n, middle = field.force_n[0, :, 0], abs(field.x_m) < 0.031
    beside = (abs(field.x_m) > 0.033) & (abs(field.x_m) < 0.09)
    assert not force_n[middle].any()
    assert force_n[beside] == pytest.approx(
        -np.sign(field.x_m[beside]) * drive_of(Cell()).a * 0.0635
    )


def test_columns_that_come_and_go_split_the_middle_into_three_stable_places():
    """A third column touches at 1.5 d - L/2 and takes load away from the far side."""
    field = mapped(plane(), inward(plane(), 2.0))
    kinds = {round(rest.x_m, 4): rest.kind for rest in field.places}
    touch_m = round(1.5 * PITCH_M - BOX.length_m / 2, 4)
    assert kinds[touch_m] is kinds[-touch_m] is Stability.SADDLE
    stable = [x for x, kind in kinds.items() if kind is Stability.STABLE]
    assert stable == pytest.approx([-0.0212, 0.0, 0.0212])
    assert len(kinds) == 5


def test_wheels_beside_their_cells_centres_shift_where_a_field_holds():
    shifted = mapped(plane(offset_m=0.03), inward(plane(offset_m=0.03), 2.0))
    places = [(rest.x_m, rest.y_m) for rest in shifted.places if rest.kind is Stability.STABLE]
    assert len(places) == 1
    assert abs(places[0][0]) > 0.03


def test_squeeze_holds_across_its_line_and_frees_along_it():
    scenario = plane()
    wheels = build_wheels(scenario)
    reference_m_s = -2.0 * np.sign(wheels.position_m[:, 1]) * wheels.direction[:, 1]
    field = mapped(scenario, reference_m_s)
    on_line = [rest for rest in field.places if abs(rest.y_m) < 1e-6]
    assert len(on_line) > 20
    assert {rest.kind for rest in on_line} == {Stability.NEUTRAL}
    assert not any(rest.alone for rest in on_line)


def test_viscous_wheels_push_in_proportion_to_their_speeds():
    slow, fast = (
        held_force(
            running_wheels_of(row(viscous_friction_s_per_m=2.0), np.full(10, speed), Law.SLIDING),
            held_parcel(row(), ROW_BOX),
            0.01,
            0.0,
            0.0,
        )[0]
        for speed in (0.1, 0.3)
    )
    droop = drive_of(Cell()).droop
    assert slow == pytest.approx(2.0 * 2.0 * 9.81 * 0.1 * droop)
    assert fast == pytest.approx(3 * slow)


def test_map_tells_where_the_parcel_tips():
    field = mapped(plane(), inward(plane(), 2.0))
    outside = abs(field.x_m) > 2.5 * PITCH_M + 1e-9
    assert np.isnan(field.force_n[:, outside]).all()
    assert np.isfinite(field.force_n[36, ~outside]).all()


def test_mirrored_field_turns_a_parcel_the_other_way():
    field = mapped(plane(), inward(plane(), 2.0))
    assert field.turning_nm == pytest.approx(-field.turning_nm[::-1], abs=1e-6)
    assert any(turn.stable for turn in field.turns)


def test_parcel_settles_at_the_equilibrium():
    scenario = row()
    table = running_wheels_of(scenario, inward(scenario, 10.0), Law.SLIDING)
    place_m = settle(table, held_parcel(scenario, ROW_BOX), np.array([0.02, 0.0]), 0.0, 0.03)
    assert place_m == pytest.approx([0.0, 0.0], abs=1e-5)


def test_uniform_field_holds_a_parcel_nowhere():
    scenario = plane(replace(BOX, x_m=0.05))
    field = mapped(scenario, build_wheels(scenario).direction[:, 0] * 1.0)
    assert field.places == ()
    assert (field.settled_m == (0.05, 0.0)).all()


@pytest.mark.parametrize(
    ("matrix", "kind"),
    [
        ([[-2.0, 0.0], [0.0, -1.0]], Stability.STABLE),
        ([[-1.0, -2.0], [2.0, -1.0]], Stability.SPIRAL),
        ([[-1.0, 0.0], [0.0, 1.0]], Stability.SADDLE),
        ([[2.0, 0.0], [0.0, 1.0]], Stability.UNSTABLE),
        ([[0.0, -1.0], [1.0, 0.0]], Stability.NEUTRAL),
    ],
)
def test_linear_forces_are_told_apart_by_their_eigenvalues(matrix, kind):
    centre_m = np.array([0.013, -0.007])

    def forces_at(x_m, y_m):
        places = np.stack(np.meshgrid(x_m, y_m), axis=-1)
        return (places - centre_m) @ np.array(matrix).T

    axis_m = np.linspace(-0.1, 0.1, 21)
    (rest,) = place_rests(axis_m, axis_m, forces_at(axis_m, axis_m), forces_at)
    assert (rest.x_m, rest.y_m) == pytest.approx(tuple(centre_m), abs=1e-9)
    assert rest.kind is kind


def test_turns_are_found_at_zeros_and_jumps_of_the_torque():
    yaw_rad = np.linspace(-3.0, 3.0, 601)
    (falling,) = turn_rests(yaw_rad, 0.5 - yaw_rad, 1e-12)
    assert (falling.yaw_rad, falling.stable) == (pytest.approx(0.5), True)
    (jump,) = turn_rests(yaw_rad, np.where(yaw_rad > 1.0, 2.0, -1.0), 1e-12)
    assert (jump.yaw_rad, jump.stable) == (pytest.approx(1.0, abs=0.01), False)
    assert turn_rests(yaw_rad, np.zeros(601), 1e-12) == []
