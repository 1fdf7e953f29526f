"""Laws that hold however parcels are thrown onto wheels that run as they like."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.sim_bus.physics.tables import (
    BOX,
    G_M_S2,
    OMNI,
    TOGETHER,
    kinetic_j,
    plane,
    rigid_speed,
    throw,
)

from mdms_model.run.record import Contact
from mdms_sim.physics.plane.world import World


def wild_world(seed, **cell):
    """A parcel thrown onto wheels that run at random, some rolling and some slipping."""
    chance = np.random.default_rng(seed)
    pose = dict(zip(("x_m", "y_m", "yaw_rad"), chance.uniform(-0.1, 0.1, 3), strict=True))
    parcel = replace(BOX, **pose, centre_of_mass_m=(0.03, -0.02))
    world = World(plane(parcel, wheel=OMNI, **cell))
    throw(world, chance.normal(0.0, [0.1, 0.1, 0.5]))
    return world, chance.normal(0.0, 0.2, len(world.wheels.cell))


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10**6), st.booleans())
def test_no_wheel_exceeds_its_friction_and_slipping_wheels_push_with_their_slip(seed, ideal):
    world, reference = wild_world(seed, rotor_inertia_kg_m2=2e-6)
    for _ in range(50):
        if ideal:
            world.step_ideal(reference, 1e-3)
        else:
            world.step_voltage(30.0 * reference, 1e-3)
        force, slip, contact = world.force_n, world.slip_m_s, world.contact
        assert (abs(force) <= 0.3 * world.normal_n + 1e-12).all()
        assert (force * slip >= -1e-12).all()
        assert not force[contact == Contact.NONE].any()
        assert (force[contact == Contact.SLIDING_FORWARD] >= 0.0).all()
        assert (force[contact == Contact.SLIDING_BACKWARD] <= 0.0).all()
        assert not slip[contact == Contact.ROLLING].any()
        assert world.normal_n.sum() == pytest.approx(2.0 * G_M_S2)


@given(st.integers(0, 10**6))
@settings(deadline=None, max_examples=20)
def test_work_of_ideal_motors_is_kinetic_energy_and_dissipation(seed):
    world, reference = wild_world(seed)
    start_j, work_j, lost_j = kinetic_j(world), 0.0, 0.0
    for _ in range(100):
        world.step_ideal(reference, 1e-3)
        work_j += 1e-3 * (world.force_n * world.wheel_speed_m_s).sum()
        lost_j += 1e-3 * (world.force_n * world.slip_m_s).sum()
    assert lost_j > 0.0
    assert work_j == pytest.approx(kinetic_j(world) - start_j + lost_j, rel=1e-10, abs=1e-12)


def test_work_of_motors_with_inertia_is_kinetic_energy_and_dissipation_at_small_steps():
    """Slip's loss is taken from the parcel's own motion, so nothing here is true by definition."""
    world, reference = wild_world(3, rotor_inertia_kg_m2=2e-6, pwm_steps=10**6)
    wheels, step_s, voltage_v = world.scene.model.wheels, 1e-6, 20.0 * reference
    moving, body = world.scene.state.wheels, world.scene.state.parcels[0]
    answer = world.scene.scratch.wheels
    wheel_j = 0.5 * (wheels["mass_kg"] * moving["speed_m_s"] ** 2).sum()
    start_j, work_j, lost_j = kinetic_j(world) + wheel_j, 0.0, 0.0
    for _ in range(20_000):
        travel, speed = world.wheel_travel_m, world.wheel_speed_m_s
        x, y, yaw = body["x_m"], body["y_m"], body["yaw_rad"]
        world.step_voltage(voltage_v, step_s)
        travel = world.wheel_travel_m - travel
        mean = (speed + world.wheel_speed_m_s) / 2
        work_j += ((answer["drive_n"] - wheels["loss"] * mean) * travel).sum()
        moved = (body["x_m"] - x, body["y_m"] - y, body["yaw_rad"] - yaw)
        middle = (x + moved[0] / 2, y + moved[1] / 2)
        lost_j += (world.force_n * (travel - rigid_speed(world, moved, middle))).sum()
    wheel_j = 0.5 * (wheels["mass_kg"] * moving["speed_m_s"] ** 2).sum()
    assert lost_j > 0.0
    assert work_j == pytest.approx(kinetic_j(world) + wheel_j - start_j + lost_j, rel=1e-6)


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 10**6), st.booleans())
def test_a_mirrored_table_gives_the_mirrored_motion(seed, ideal):
    chance = np.random.default_rng(seed)
    x_m, y_m, yaw_rad = chance.uniform(-0.1, 0.1, 3)
    inertia = {"wheel": TOGETHER, "rotor_inertia_kg_m2": 2e-6}
    world = World(plane(replace(BOX, x_m=x_m, y_m=y_m, yaw_rad=yaw_rad), **inertia))
    mirror = World(plane(replace(BOX, x_m=x_m, y_m=-y_m, yaw_rad=-yaw_rad), **inertia))
    drives = chance.normal(0.0, 0.3, (3, 6, 2))
    mirrored = drives[::-1] * [1.0, -1.0]
    for _ in range(200):
        if ideal:
            world.step_ideal(drives.ravel(), 1e-3)
            mirror.step_ideal(mirrored.ravel(), 1e-3)
        else:
            world.step_voltage(20 * drives.ravel(), 1e-3)
            mirror.step_voltage(20 * mirrored.ravel(), 1e-3)
    assert mirror.pose * [1.0, -1.0, -1.0] == pytest.approx(world.pose, abs=1e-9)


def test_a_run_repeats_to_the_last_bit():
    first, second = (wild_world(11, motor_spread=0.1, rotor_inertia_kg_m2=2e-6) for _ in range(2))
    for world, reference in (first, second):
        for _ in range(300):
            world.step_voltage(20.0 * reference, 1e-3)
    assert first[0].pose.tobytes() == second[0].pose.tobytes()
    assert first[0].wheel_travel_m.tobytes() == second[0].wheel_travel_m.tobytes()


def test_firmware_tends_to_ideal_as_tick_and_inertia_vanish():
    """The sampled proportional law on wheels with inertia, against the continuous law on none."""
    parcel, errors = replace(BOX, x_m=0.02, y_m=0.01, yaw_rad=0.2), []
    world = World(plane(parcel))
    reference = rigid_speed(world, (0.05, 0.02, 0.3))
    for _ in range(5000):
        world.step_ideal(reference, 5e-5)
    for tick_s in (1e-3, 5e-4, 2.5e-4):
        light = World(plane(parcel, rotor_inertia_kg_m2=1e-3 * tick_s, pwm_steps=10**6))
        for _ in range(round(0.25 / tick_s)):
            light.step_voltage(10.0 * (reference - light.wheel_speed_m_s), tick_s)
        errors.append(np.abs(light.pose - world.pose).max())
    assert errors[2] < 2e-4
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.2)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=0.2)


def test_viscous_sliding_under_voltage_tends_to_that_of_the_ideal_law():
    film, errors = {"viscous_friction_s_per_m": 0.5}, []
    world = World(plane(replace(BOX, yaw_rad=0.2), **film))
    reference = rigid_speed(world, (0.05, 0.02, 0.3))
    for _ in range(5000):
        world.step_ideal(reference, 5e-5)
    assert world.slip_m_s.any()
    for tick_s in (1e-3, 5e-4, 2.5e-4):
        fine = {"rotor_inertia_kg_m2": 1e-3 * tick_s, "pwm_steps": 10**6}
        light = World(plane(replace(BOX, yaw_rad=0.2), **film, **fine))
        for _ in range(round(0.25 / tick_s)):
            light.step_voltage(10.0 * (reference - light.wheel_speed_m_s), tick_s)
        errors.append(np.abs(light.pose - world.pose).max())
    assert errors[2] < 1e-4
    assert errors[0] / errors[2] == pytest.approx(4.0, rel=0.3)
