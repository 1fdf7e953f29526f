"""Policies keep references where the paper says that all wheels roll, or slide at equilibrium."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mdms_model.array import build_wheels
from mdms_model.fields import PolicyError, accepted, bound_of, command_of, references_m_s
from mdms_model.motor import drive_of
from mdms_model.run.record import Contact
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.motion import Part
from mdms_model.scenario.scenario import Parcel, Patch
from mdms_sim.physics.plane.ideal import solve_ideal
from mdms_sim.physics.row.solver import solve_row

ROW = load_scenario("paper-fig7")
ROLLING_M_S, SLIDING_M_S = 0.0634625, 0.207645
PLANE = load_scenario(
    "array18",
    [
        *("run.fidelity=ideal", "run.step_s=0.002", "run.duration_s=2"),
        *("cell.friction_spread=0", "cell.motor_spread=0", "motion.field=inward"),
    ],
)


def moved(scenario=ROW, **motion):
    return replace(scenario, motion=replace(scenario.motion, **motion))


def slid(record):
    return record.contact >= Contact.SLIDING_FORWARD


def test_without_a_policy_any_reference_goes():
    command = accepted(moved(speed_m_s=10.0))
    assert command.bound is None
    assert abs(command.set_m_s).max() == 10.0


@pytest.mark.parametrize("policy", ["rolling", "sliding"])
def test_an_empty_table_takes_any_reference(policy):
    command = accepted(replace(moved(PLANE, policy=policy, speed_m_s=10.0), parcel=()))
    assert command.bound is None
    assert abs(command.set_m_s).max() == 10.0


def test_too_fast_to_roll_is_refused_with_the_numbers_and_the_way_out():
    with pytest.raises(
        PolicyError,
        match=r"10 of 10 wheels have references of up to 0.0635 m/s; .*3.43 N of parcel 'box' "
        r".*0.06346 m/s \(eq 14\), and at rest up to 0.1454 m/s \(eq 17\); lower .*'clamp'",
    ):
        accepted(moved(policy="rolling"))


def test_too_slow_to_slide_is_refused_with_the_numbers_and_the_way_out():
    with pytest.raises(
        PolicyError,
        match=r"references of only 0.2 m/s; .*parcel 'box' at rest from 0.2076 m/s on "
        r"\(eq 15\); raise .*motion.outside to 'clamp'",
    ):
        accepted(moved(policy="sliding", speed_m_s=0.2))


@pytest.mark.parametrize(
    ("policy", "speed_m_s"), [("rolling", 0.0634), ("sliding", 0.2077), ("sliding", 0.75)]
)
def test_a_value_inside_stays_as_it_is(policy, speed_m_s):
    command = accepted(moved(policy=policy, speed_m_s=speed_m_s))
    np.testing.assert_array_equal(command.set_m_s, command.asked_m_s)
    assert str(command) == ""


@settings(max_examples=25, deadline=None)
@given(st.floats(0.01, 10.0), st.floats(-0.4, 0.4))
def test_no_contact_slides_on_the_row_where_the_policy_clamps_to_roll(speed_m_s, x_m):
    scenario = moved(policy="rolling", outside="clamp", speed_m_s=speed_m_s)
    scenario = replace(
        scenario,
        parcel=(replace(scenario.parcel[0], x_m=x_m),),
        run=replace(scenario.run, duration_s=5.0),
    )
    assert not slid(solve_row(scenario, accepted(scenario).set_m_s)).any()


@pytest.fixture(scope="module")
def rolling():
    """The bound in the plane, which takes a search over all poses."""
    return bound_of(moved(PLANE, policy="rolling", light_share=0.5))


@pytest.mark.parametrize("field", ["inward", "uniform", "rotate", "squeeze", "elliptic", "twist"])
def test_no_loaded_contact_slides_in_the_plane_where_the_policy_clamps_to_roll(rolling, field):
    part = Part(field, speed_m_s=0.3, heading_rad=0.5, velocity_m_s=(0.2, -0.1), yaw_rate_rad_s=1.0)
    scenario = replace(PLANE, parcel=(replace(PLANE.parcel[0], x_m=0.07, yaw_rad=0.4),))
    wheels = build_wheels(scenario)
    asked_m_s = references_m_s(part, wheels)
    record = solve_ideal(scenario, rolling.clamp(asked_m_s, wheels.cell))
    loaded = record.normal_n >= rolling.normal_n
    assert loaded.sum() > 1000
    assert not (slid(record) & loaded).any()
    # It is the clamp that does it.
    fast = solve_ideal(scenario, asked_m_s)
    assert (slid(fast) & (fast.normal_n >= rolling.normal_n)).any()


@pytest.mark.parametrize(("scenario", "solve"), [(ROW, solve_row), (PLANE, solve_ideal)])
def test_all_contacts_slide_at_equilibrium_from_eq_15_on_and_not_below(scenario, solve):
    """The parcel lies where the array is alike on both sides, and has just been set down."""
    resting = replace(scenario.parcel[0], x_m=0.0, y_m=0.0)
    row = scenario is ROW
    # Wheels beside their cells' centres would twist the parcel out of equilibrium.
    wheels = (
        scenario.cell.wheel
        if row
        else tuple(replace(wheel, offset_m=(0.0, 0.0)) for wheel in scenario.cell.wheel)
    )
    scenario = replace(
        scenario,
        parcel=(resting,),
        cell=replace(scenario.cell, wheel=wheels),
        array=replace(scenario.array, rows=1 if row else 4),
        run=replace(scenario.run, duration_s=0.1),
    )
    clamped = moved(scenario, policy="sliding", outside="clamp", speed_m_s=0.01)
    command = accepted(clamped)
    touching = solve(clamped, command.set_m_s).contact != Contact.NONE
    assert touching.any()
    assert slid(solve(clamped, command.set_m_s))[touching].all()
    slower = solve(clamped, 0.99 * command.bound.limit_m_s * np.sign(command.set_m_s))
    assert not slid(slower)[touching].all()


def test_the_parcel_that_bounds_most_counts():
    light = replace(ROW.parcel[0], name="light", mass_kg=1.0, x_m=0.3)
    both = replace(ROW, parcel=(ROW.parcel[0], light))
    assert command_of(moved(both, policy="rolling")).bound.parcel == "light"
    assert command_of(moved(both, policy="sliding")).bound.parcel == "box"


def test_the_slipperiest_cell_bounds_rolling_and_the_roughest_sliding():
    patched = replace(ROW, patch=(Patch((1,), friction=0.15), Patch((2,), friction=0.6)))
    rolling, sliding = (command_of(moved(patched, policy=p)).bound for p in ("rolling", "sliding"))
    assert rolling.limit_m_s == pytest.approx(ROLLING_M_S / 2, rel=1e-4)
    assert sliding.limit_m_s == pytest.approx(SLIDING_M_S * 2, rel=1e-4)


def test_clamping_to_roll_keeps_the_direction_in_which_each_cell_pushes(rolling):
    wheels = build_wheels(PLANE)
    asked_m_s = references_m_s(Part("rotate", speed_m_s=0.3), wheels)
    made_m_s = rolling.clamp(asked_m_s, wheels.cell)
    asked, made = asked_m_s.reshape(-1, 2), made_m_s.reshape(-1, 2)
    np.testing.assert_allclose(asked[:, 0] * made[:, 1], asked[:, 1] * made[:, 0], atol=1e-15)
    assert abs(made).max() == pytest.approx(rolling.limit_m_s)
    assert not rolling.outside(made_m_s * (1 - 1e-12)).any()


def test_clamping_to_slide_leaves_wheels_that_push_nowhere_alone():
    along = moved(PLANE, field="uniform", speed_m_s=0.01, policy="sliding", outside="clamp")
    made = command_of(along).set_m_s.reshape(-1, 2)
    assert (made[:, 0] > 0.01).all()
    assert not made[:, 1].any()


def test_where_a_wheel_may_carry_nothing_rolling_is_refused_until_light_ones_may_slip(rolling):
    with pytest.raises(PolicyError, match=r"'box' carries nothing .*motion.light_share=0.3"):
        command_of(moved(PLANE, policy="rolling"))
    assert rolling.limit_m_s > 0.0


def test_where_the_parcel_tips_at_the_centre_sliding_is_refused():
    small = Parcel("cup", mass_kg=1.0, length_m=0.1, width_m=0.1)
    scenario = moved(replace(ROW, parcel=(small,)), policy="sliding")
    with pytest.raises(PolicyError, match=r"'cup' tips at the array's centre"):
        command_of(scenario)


def test_compensated_droop_makes_surface_speeds_of_the_fields_numbers():
    command = command_of(moved(compensate_droop=True))
    drive = drive_of(ROW.cell)
    np.testing.assert_allclose(abs(command.set_m_s), 0.0635 * drive.b / drive.a)
    # A free wheel runs at (a/b) r.
    record = solve_row(
        replace(moved(compensate_droop=True), run=replace(ROW.run, duration_s=0.1)), command.set_m_s
    )
    free = (record.contact == Contact.NONE).all(axis=0)
    np.testing.assert_allclose(abs(record.speed_m_s[-1][free]), 0.0635)


def test_wheels_of_the_command_are_those_of_the_array():
    assert command_of(PLANE).set_m_s.shape == build_wheels(PLANE).cell.shape
