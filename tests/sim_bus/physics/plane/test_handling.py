"""Parcels that hands push, lift and set down again."""

from dataclasses import replace

import numpy as np
import pytest
from tests.sim_bus.physics.tables import BOX, plane, throw

from mdms_sim.physics.plane.handling import lift, push, set_down
from mdms_sim.physics.plane.world import World

STILL = np.zeros((18, 2), np.int32)
EDGY = replace(BOX, centre_of_mass_m=(0.05, -0.02))


def go_on(world, steps):
    for _ in range(steps):
        world.step_cells(STILL, 1e-3)


def test_a_push_gives_the_parcel_its_impulse_over_its_mass():
    world = World(plane(BOX))
    assert push(world.scene, 0, (1.0, -0.5), 0.1)
    inertia_kg_m2 = BOX.mass_kg * (BOX.length_m**2 + BOX.width_m**2) / 12
    expected = (1.0 / BOX.mass_kg, -0.5 / BOX.mass_kg, 0.1 / inertia_kg_m2)
    assert world.twist[0] == pytest.approx(expected)
    go_on(world, 500)
    assert world.pose[0, 0] > 0.005
    assert world.pose[0, 1] < -0.002


def test_a_lifted_parcel_rests_on_nothing_covers_no_sensor_and_stays_in_the_air():
    world = World(plane(BOX))
    throw(world, (0.3, 0.0, 0.0))
    go_on(world, 20)
    assert world.presence().any()
    lift(world.scene, 0)
    pose = world.pose.copy()
    go_on(world, 100)
    assert not world.presence().any()
    assert (world.normal_n == 0.0).all()
    assert (world.contact == 0).all()
    assert np.array_equal(world.pose, pose)
    assert (world.twist == 0.0).all()
    assert not push(world.scene, 0, (1.0, 0.0), 0.0)
    assert (world.twist == 0.0).all()


def test_a_parcel_passes_under_a_lifted_one_and_meets_it_when_it_is_set_down():
    world = World(plane(replace(BOX, name="a", x_m=-0.19), replace(BOX, name="b", x_m=0.19)))
    lift(world.scene, 1)
    throw(world, (0.6, 0.0, 0.0), (0.0, 0.0, 0.0))
    world.bridges.awake[:] = 0
    go_on(world, 300)
    passed_m = world.pose[0, 0]
    assert passed_m > -0.19 + 0.05
    assert not [event for event in world.events if event.kind == "touch"]
    assert set_down(world.scene, 1, 0.37, None, None)
    world.scene.state.parcels[0].vx_m_s = 0.6
    go_on(world, 300)
    assert [event.parcel for event in world.events if event.kind == "touch"] == ["a"]


def test_a_parcel_is_set_down_at_rest_where_it_is_put_by_its_origin():
    world = World(plane(EDGY))
    lift(world.scene, 0)
    go_on(world, 10)
    assert set_down(world.scene, 0, 0.1, None, 0.5)
    assert world.pose[0] == pytest.approx((0.1, 0.0, 0.5))
    go_on(world, 50)
    assert world.pose[0] == pytest.approx((0.1, 0.0, 0.5), abs=1e-6)
    assert world.normal_n.sum() == pytest.approx(BOX.mass_kg * 9.81)
    assert world.presence().any()


def test_a_parcel_that_two_hold_is_on_the_table_when_both_have_let_go():
    world = World(plane(BOX))
    lift(world.scene, 0)
    lift(world.scene, 0)
    assert not set_down(world.scene, 0, None, None, None)
    go_on(world, 5)
    assert not world.presence().any()
    assert set_down(world.scene, 0, None, None, None)
    go_on(world, 5)
    assert world.presence().any()


def test_a_parcel_in_the_air_does_not_tip_and_one_set_down_beside_its_supports_does():
    world = World(plane(BOX))
    lift(world.scene, 0)
    world.scene.state.parcels[0].x_m = 0.5
    go_on(world, 20)
    assert not world.events
    set_down(world.scene, 0, 0.45, 0.0, 0.0)
    go_on(world, 20)
    assert [event.kind for event in world.events] == ["tip"]


def test_a_world_goes_back_to_before_its_parcel_was_lifted():
    world = World(plane(BOX))
    throw(world, (0.3, 0.0, 0.1))
    go_on(world, 20)
    state = world.state()
    go_on(world, 50)
    went_on = world.pose.tobytes()
    world.restore(state)
    lift(world.scene, 0)
    go_on(world, 50)
    world.restore(state)
    go_on(world, 50)
    assert world.pose.tobytes() == went_on
