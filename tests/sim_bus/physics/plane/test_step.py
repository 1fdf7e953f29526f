"""A step of parcels on wheels against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.sim_bus.physics.tables import (
    BOX,
    G_M_S2,
    OMNI,
    PAIR,
    TOGETHER,
    plane,
    rigid_speed,
    throw,
)

from mdms_model.motor import drive_of
from mdms_model.scenario.scenario import Parcel, Wheel
from mdms_sim.physics.plane.world import World


def test_a_parcel_at_rest_on_still_wheels_stays():
    world = World(plane(replace(BOX, x_m=0.05, yaw_rad=0.3)))
    for _ in range(100):
        world.step_ideal(np.zeros(36), 1e-3)
        world.step_voltage(np.zeros(36), 1e-3)
    assert world.pose.tolist() == [[0.05, 0.0, 0.3]]
    assert not world.twist.any()


def test_a_uniform_field_that_slips_accelerates_by_mu_g():
    world = World(plane(wheel=(Wheel(0.0),), rows=3))
    for _ in range(100):
        world.step_ideal(np.full(18, 10.0), 1e-3)
    assert world.twist[0] == pytest.approx([0.3 * G_M_S2 * 0.1, 0.0, 0.0], abs=1e-12)
    assert world.pose[0, 0] == pytest.approx(0.5 * 0.3 * G_M_S2 * 0.1**2, rel=1e-12)


def test_half_of_the_wheels_pull_along_x_in_an_array_of_pairs():
    world = World(plane(wheel=TOGETHER))
    fast = np.where(world.wheels.direction[:, 0] > 0.5, 10.0, 0.0)
    for _ in range(50):
        world.step_ideal(fast, 1e-3)
    assert world.twist[0] == pytest.approx([0.3 * G_M_S2 * 0.05 / 2, 0.0, 0.0], abs=1e-12)


def test_a_uniform_field_that_rolls_approaches_its_speed_exponentially():
    scenario = plane(replace(BOX, length_m=0.4), wheel=(Wheel(0.0),))
    drive = drive_of(scenario.cell)
    end = drive.droop * 0.01
    errors = []
    for steps in (10, 20, 40):
        world = World(scenario)
        for _ in range(steps):
            world.step_ideal(np.full(18, 0.01), 0.02 / steps)
        supports = (world.normal_n > 0).sum()
        rate = supports * drive.b / BOX.mass_kg
        errors.append(abs(world.twist[0, 0] - end * (1 - np.exp(-rate * 0.02))))
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.1)
    assert errors[2] < 1e-4 * end


@pytest.mark.parametrize("wheel", [PAIR, TOGETHER, OMNI], ids=["pair", "together", "omni"])
def test_a_rigid_field_pushes_nothing_that_moves_with_it(wheel):
    world = World(plane(replace(BOX, x_m=0.04, y_m=-0.02, yaw_rad=0.5), wheel=wheel))
    drive, twist = drive_of(world.scenario.cell), (0.05, -0.03, 0.4)
    throw(world, twist)
    about = world.pose[0, :2] + 0.5e-3 * world.twist[0, :2]
    world.step_ideal(rigid_speed(world, twist, about) / drive.droop, 1e-3)
    assert world.twist[0] == pytest.approx(twist, rel=1e-13)
    assert world.force_n == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("twist", "drift"),
    [((0.02, -0.01, 0.0), 1e-10), ((0.0, 0.0, 0.3), 1e-4)],
    ids=["straight", "turning"],
)
@pytest.mark.parametrize("wheel", [PAIR, TOGETHER, OMNI], ids=["pair", "together", "omni"])
def test_a_parcel_takes_up_the_rigid_twist_it_is_driven_with(wheel, twist, drift):
    """Spinning up moves the middle off the field's centre a little, about which it then drifts."""
    world = World(plane(wheel=wheel))
    reference = rigid_speed(world, twist) / drive_of(world.scenario.cell).droop
    for _ in range(2000):
        world.step_ideal(reference, 1e-3)
    assert world.twist[0] == pytest.approx(twist, abs=drift)


def test_a_disc_on_still_wheels_spins_down_evenly_and_then_exponentially():
    disc = Parcel("disc", 2.0, 0.3, 0.3, shape="disc")
    scenario = plane(disc, wheel=TOGETHER, columns=2, rows=2)
    world, lever = World(scenario), 0.127 / 2
    inertia = 2.0 * 0.15**2 / 2
    slowing = 0.3 * 2.0 * G_M_S2 * lever / inertia
    limit = 0.3 * 2.0 * G_M_S2 / 8 / drive_of(scenario.cell).b / lever  # b u = mu N
    throw(world, (0.0, 0.0, 10.0))
    for _ in range(40):
        world.step_ideal(np.zeros(8), 1e-3)
    assert world.twist[0] == pytest.approx([0.0, 0.0, 10.0 - slowing * 0.04], abs=1e-12)
    slides_s = (10.0 - limit) / slowing
    for _ in range(2000):
        world.step_ideal(np.zeros(8), (slides_s + 0.01 - 0.04) / 2000)
    rolling = limit * np.exp(-8 * drive_of(scenario.cell).b * lever**2 / inertia * 0.01)
    assert world.twist[0, 2] == pytest.approx(rolling, rel=1e-5)


@given(
    st.floats(-0.3, 0.3),
    st.floats(-0.5, 0.5),
    st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)),
)
def test_viscous_sliding_in_a_linear_field_knows_no_supports(x_m, speed_m_s, line):
    parcel = replace(BOX, length_m=0.42, x_m=x_m)
    stiff = {"viscous_friction_s_per_m": 0.5, "gain_vs_per_m": 1e9}
    world = World(plane(parcel, wheel=(Wheel(0.0),), columns=10, rows=1, **stiff))
    throw(world, (speed_m_s, 0.0, 0.0))
    slope, offset = line
    step_s = 1e-9
    world.step_ideal(slope * world.wheels.position_m[:, 0] + offset, step_s)
    expected = 0.5 * 2.0 * G_M_S2 * (slope * x_m + offset - speed_m_s)
    assert world.force_n.sum() == pytest.approx(expected, rel=1e-6, abs=1e-6)


@given(st.integers(0, 10**6))
def test_viscous_sliding_in_a_plane_pushes_with_half_of_the_weight_each_way(seed):
    """Each of two wheels at one point carries half of the cell's load and pushes one way only."""
    chance = np.random.default_rng(seed)
    x_m, y_m, yaw_rad = chance.uniform(-0.1, 0.1, 3)
    stiff = {"viscous_friction_s_per_m": 0.5, "gain_vs_per_m": 1e9}
    world = World(plane(replace(BOX, x_m=x_m, y_m=y_m, yaw_rad=yaw_rad), wheel=TOGETHER, **stiff))
    matrix, offset, twist = chance.normal(size=(2, 2)), chance.normal(size=2), chance.normal(size=3)
    throw(world, twist)
    field = world.wheels.position_m @ matrix.T + offset
    world.step_ideal((field * world.wheels.direction).sum(axis=1), 1e-9)
    force_n = world.force_n @ world.wheels.direction
    expected = 0.5 * 2.0 * G_M_S2 / 2 * (matrix @ [x_m, y_m] + offset - twist[:2])
    assert force_n == pytest.approx(expected, rel=1e-6, abs=1e-6)
