"""Parcels that meet push each other: inelastic, without friction."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.sim_bus.physics.tables import BOX, kinetic_j, plane, throw

from mdms_sim.physics.plane.records import NOW
from mdms_sim.physics.plane.world import World


def world_of(*parcels, friction=0.3, columns=12, rows=6):
    cell = {"friction": friction, "rotor_inertia_kg_m2": 2e-6}
    return World(plane(*parcels, columns=columns, rows=rows, **cell))


def momenta(world):
    """Momentum along x and y, and angular momentum about the table's origin."""
    b, constants = world.scene.state.parcels, world.scene.model.parcels
    mass_kg = constants["mass_kg"]
    turning = constants["inertia_kg_m2"] * b["yaw_rate_rad_s"]
    moment = mass_kg * (b["x_m"] * b["vy_m_s"] - b["y_m"] * b["vx_m_s"]) + turning
    return np.array([mass_kg @ b["vx_m_s"], mass_kg @ b["vy_m_s"], moment.sum()])


@pytest.mark.parametrize("ideal", [True, False])
def test_a_thrown_box_carries_a_resting_one_along_with_the_momentum_shared(ideal):
    world = world_of(
        replace(BOX, name="a", x_m=-0.2), replace(BOX, name="b", x_m=0.17, mass_kg=1.0), friction=0
    )
    throw(world, (0.3, 0.0, 0.0), (0.0, 0.0, 0.0))
    for _ in range(100):
        world.step_ideal(np.zeros(144), 1e-3) if ideal else world.step_voltage(np.zeros(144), 1e-3)
    assert world.twist == pytest.approx(np.array([[0.2, 0.0, 0.0]] * 2), abs=1e-9)
    assert world.pose[1, 0] - world.pose[0, 0] == pytest.approx(0.36, abs=1.5e-4)
    (event,) = world.events
    assert (event.kind, event.parcel) == ("touch", "a")
    assert event.time_s == pytest.approx(0.01 / 0.3, abs=2e-3)
    assert "touches b at x -0.0" in event.detail


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10**6))
def test_a_meeting_keeps_the_momenta_and_never_adds_energy(seed):
    chance = np.random.default_rng(seed)
    disc = replace(BOX, name="b", shape="disc", length_m=0.25, width_m=0.25, x_m=0.25)
    other = replace(disc, y_m=chance.uniform(-0.1, 0.1))
    if chance.random() < 0.5:
        other = replace(other, shape="rectangle", length_m=0.2, yaw_rad=chance.uniform(-2, 2))
    world = world_of(replace(BOX, name="a", x_m=-0.1), other, friction=0)
    throw(world, (chance.uniform(0.2, 0.5), 0.0, chance.normal()), (0.0, 0.0, chance.normal()))
    before, energy_j = momenta(world), kinetic_j(world)
    for _ in range(500):
        world.step_ideal(np.zeros(144), 1e-3)
    assert world.events
    assert momenta(world) == pytest.approx(before, abs=2e-3 * np.abs(before).max())
    assert momenta(world)[:2] == pytest.approx(before[:2], abs=1e-9)
    assert kinetic_j(world) < energy_j


def test_a_driven_box_pushes_a_row_of_others_and_none_sinks_into_the_next():
    parcels = [replace(BOX, name=f"{i}", length_m=0.2, x_m=-0.5 + 0.21 * i) for i in range(4)]
    world = world_of(*parcels)
    driven = world.wheels.position_m[:, 0] < -0.3
    along = world.wheels.direction[:, 0] > 0.5
    for _ in range(2000):
        world.step_ideal(np.where(driven & along, 0.3, 0.0), 1e-3)
    gaps_m = (
        np.diff(
            world.pose[
                :,
                0,
            ]
        )
        - 0.2
    )
    assert (gaps_m > -2e-4).all()
    assert gaps_m[0] < 1e-5
    assert world.pose[1, 0] > -0.29 + 0.05


def test_boxes_pressed_together_by_their_wheels_stay_face_to_face():
    world = world_of(
        replace(BOX, name="a", x_m=-0.25), replace(BOX, name="b", x_m=0.2, y_m=0.02, yaw_rad=0.2)
    )
    inward = -0.1 * np.sign(world.wheels.position_m[:, 0])
    reference = np.where(world.wheels.direction[:, 0] > 0.5, inward, 0.0)
    for _ in range(6000):
        world.step_ideal(reference, 1e-3)
    touches = world.scene.scratch.touches[: world.scene.scratch.tally[NOW]]
    assert (touches["force_n"] > 0.0).all()
    assert len(touches) == 2
    assert world.pose[0, 2] == pytest.approx(world.pose[1, 2], abs=1e-3)


def test_parcels_that_part_and_meet_again_touch_twice():
    world = world_of(replace(BOX, name="a", x_m=-0.2), replace(BOX, name="b", x_m=0.2), friction=0)
    throw(world, (0.2, 0.0, 0.0), (-0.2, 0.0, 0.0))
    for velocity in (-0.2, 0.2):
        for _ in range(250):
            world.step_ideal(np.zeros(144), 1e-3)
        throw(world, (velocity, 0.0, 0.0), (-velocity, 0.0, 0.0))
    for _ in range(500):
        world.step_ideal(np.zeros(144), 1e-3)
    assert [event.kind for event in world.events] == ["touch", "touch"]


def test_far_parcels_move_as_if_alone():
    alone = world_of(replace(BOX, name="a", x_m=-0.5, y_m=0.1, yaw_rad=0.3))
    both = world_of(
        replace(BOX, name="a", x_m=-0.5, y_m=0.1, yaw_rad=0.3), replace(BOX, name="b", x_m=0.4)
    )
    reference = np.random.default_rng(5).normal(0.0, 0.1, 144)
    for _ in range(200):
        alone.step_ideal(reference, 1e-3)
        both.step_ideal(reference, 1e-3)
    assert both.pose[0].tolist() == alone.pose[0].tolist()
