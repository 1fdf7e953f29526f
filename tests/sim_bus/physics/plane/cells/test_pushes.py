"""What single wheels make of a reference or a voltage, and what their rollers do."""

from dataclasses import replace

import numpy as np
import pytest
from tests.sim_bus.physics.tables import BOX, G_M_S2, plane, throw

from mdms_model.motor import drive_of
from mdms_model.scenario.scenario import Wheel
from mdms_sim.physics.plane.world import World


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


def test_the_current_is_what_voltage_and_back_emf_leave_and_keeps_within_its_limit():
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
