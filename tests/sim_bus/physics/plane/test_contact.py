from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.sim_bus.physics.tables import BOX, G_M_S2, plane, throw

from mdms_model.motor import drive_of
from mdms_model.scenario.scenario import Wheel
from mdms_sim.physics.plane.contact import WheelPushes, push, settle
from mdms_sim.physics.plane.world import World

INERTIA_PER_S = (2000.0, 2000.0, 40.0)
speeds = st.floats(-3.0, 3.0)


def problem(seed, count):
    chance = np.random.default_rng(seed)
    angle = chance.uniform(0.0, 2 * np.pi, count)
    jacobian = np.column_stack([np.cos(angle), np.sin(angle), chance.uniform(-0.3, 0.3, count)])
    slope = 10.0 ** chance.uniform(-1.0, 5.0, count)
    limit = np.where(chance.random(count) < 0.2, 0.0, chance.uniform(0.0, 5.0, count))
    line = np.column_stack([slope * chance.uniform(-2.0, 2.0, count), slope, limit])
    return WheelPushes(jacobian, line, np.zeros(count, dtype=np.int8))


def forces(pushes, twist):
    wanted = pushes.line[:, 0] - pushes.line[:, 1] * (pushes.jacobian @ twist)
    return np.clip(wanted, -pushes.line[:, 2], pushes.line[:, 2])


@given(st.integers(0, 10**6), st.integers(0, 40), st.tuples(speeds, speeds, speeds))
def test_momentum_gained_is_the_push_of_the_clipped_lines(seed, count, twist):
    pushes = problem(seed, count)
    *new, steps = settle(twist, INERTIA_PER_S, pushes)
    gained = np.array(INERTIA_PER_S) * (np.array(new) - twist)
    given_n = pushes.jacobian.T @ forces(pushes, new)
    # A slope of 1e5 N s/m turns a last digit of speed into 1e-10 N.
    assert gained == pytest.approx(given_n, abs=1e-8)
    assert steps < 30


def test_a_parcel_that_rolls_on_is_found_in_one_step():
    jacobian = np.array([[1.0, 0.0, 0.1], [1.0, 0.0, -0.1], [0.0, 1.0, 0.0]])
    line = np.array([[0.9, 9.0, 6.0], [0.9, 9.0, 6.0], [0.0, 9.0, 6.0]])
    pushes = WheelPushes(jacobian, line, np.zeros(3, dtype=np.int8))
    assert settle((0.1, 0.0, 0.0), INERTIA_PER_S, pushes) == (0.1, 0.0, 0.0, 1)


def test_pieces_name_the_slipping_wheels():
    jacobian = np.array([[1.0, 0.0, 0.0]] * 3)
    line = np.array([[100.0, 10.0, 2.0], [-100.0, 10.0, 2.0], [0.0, 10.0, 2.0]])
    pushes = WheelPushes(jacobian, line, np.zeros(3, dtype=np.int8))
    *twist, _ = settle((0.0, 0.0, 0.0), INERTIA_PER_S, pushes)
    assert twist == [0.0, 0.0, 0.0]
    assert pushes.piece.tolist() == [1, -1, 0]


def test_one_wheel_pushes_along_its_line_between_its_limits():
    row = np.array([1.0, 0.0, 0.2])
    line = np.array([3.0, 10.0, 2.0])
    assert push(line, row, (0.2, 5.0, 0.5)) == pytest.approx(3.0 - 10.0 * 0.3)
    assert push(line, row, (0.0, 0.0, 0.0)) == 2.0
    assert push(line, row, (1.0, 0.0, 0.0)) == -2.0


def test_free_wheels_droop_by_a_over_b():
    fine = {"rotor_inertia_kg_m2": 2e-6, "pwm_steps": 10**6}
    world = World(plane(replace(BOX, x_m=-0.2, length_m=0.2), **fine))
    reference, gain = np.full(36, 0.1), world.scenario.cell.gain_vs_per_m
    free = world.wheels.position_m[:, 0] > 0.1
    droop = drive_of(world.scenario.cell).droop
    world.step_ideal(np.zeros(36), 1e-3)
    world.step_ideal(reference, 1e-3)
    assert world.wheel_speed_m_s[free] == pytest.approx(0.1 * droop)
    for _ in range(300):
        world.step_voltage(gain * (reference - world.wheel_speed_m_s), 1e-3)
    assert world.wheel_speed_m_s[free] == pytest.approx(0.1 * droop, rel=1e-4)


def test_rollers_with_friction_slow_a_parcel_along_the_axles():
    world = World(plane(wheel=(Wheel(0.0),), roller_friction=0.02))
    throw(world, (0.0, 0.1, 0.0))
    for _ in range(100):
        world.step_ideal(np.zeros(18), 1e-3)
    assert world.twist[0] == pytest.approx([0.0, 0.1 - 0.02 * G_M_S2 * 0.1, 0.0], abs=1e-12)
    for _ in range(900):
        world.step_voltage(np.zeros(18), 1e-3)
    assert world.twist[0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)


def test_a_free_wheel_answers_to_its_voltage_as_equation_8_says():
    world = World(plane(replace(BOX, x_m=-0.2, length_m=0.2), rotor_inertia_kg_m2=2e-6))
    cell, drive = world.scenario.cell, drive_of(world.scenario.cell)
    mass_kg = 2e-6 * (3 / 0.0254) ** 2
    loss = drive.be + drive.ke**2 / cell.resistance_ohm
    for _ in range(10):
        world.step_voltage(np.full(36, 1.2), 1e-3)
    end = 1.2 * drive.ke / cell.resistance_ohm / loss
    speed = end * (1 - np.exp(-loss * 0.01 / mass_kg))
    assert world.wheel_speed_m_s[-1] == pytest.approx(speed)
    assert world.wheel_travel_m[-1] == pytest.approx(end * 0.01 - speed * mass_kg / loss)


def test_the_current_limit_holds_the_force_of_a_starting_motor():
    parcel = replace(BOX, x_m=-0.2, length_m=0.2)
    world = World(plane(parcel, rotor_inertia_kg_m2=2e-6, damping_nms=0.0, current_limit_a=0.5))
    mass_kg, ke = 2e-6 * (3 / 0.0254) ** 2, drive_of(world.scenario.cell).ke
    for _ in range(10):
        world.step_voltage(np.full(36, -24.0), 1e-3)
    assert world.wheel_speed_m_s[-1] == pytest.approx(-ke * 0.5 / mass_kg * 0.01)


def test_the_current_follows_voltage_and_back_emf_within_its_limit():
    parcel = replace(BOX, x_m=-0.2, length_m=0.2)
    world = World(plane(parcel, rotor_inertia_kg_m2=2e-6, current_limit_a=0.5))
    cell, drive = world.scenario.cell, drive_of(world.scenario.cell)
    for _ in range(3):
        world.step_voltage(np.full(36, -12.0), 1e-3)
    assert world.motor_current_a == pytest.approx(-0.5)
    for _ in range(50):
        world.step_voltage(np.full(36, 1.2), 1e-3)
    back_emf_v = drive.ke * world.wheel_speed_m_s
    assert world.motor_current_a == pytest.approx((1.2 - back_emf_v) / cell.resistance_ohm)


def test_voltages_beyond_the_supply_and_below_a_pwm_step_are_cut():
    low, high, zero = (World(plane(pwm_steps=100)) for _ in range(3))
    for _ in range(5):
        low.step_voltage(np.full(36, 24.0), 1e-3)
        high.step_voltage(np.full(36, 99.0), 1e-3)
        zero.step_voltage(np.full(36, 0.119), 1e-3)
    assert (low.wheel_speed_m_s == high.wheel_speed_m_s).all()
    assert not zero.wheel_speed_m_s.any()
