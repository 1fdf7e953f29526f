"""The whole table: where its parcels are, what happens to them, and cells of several kinds."""

from dataclasses import replace

import numpy as np
import pytest
from tests.sim_bus.physics.tables import BOX, OMNI, plane, rigid_speed, throw

from mdms_model.motor import drive_of
from mdms_model.scenario.scenario import Patch, Wheel
from mdms_sim.physics.plane.world import World


def test_the_pose_is_that_of_the_middle_and_turns_about_the_centre_of_mass():
    parcel = replace(BOX, x_m=0.03, y_m=-0.01, yaw_rad=0.4, centre_of_mass_m=(0.05, 0.02))
    world = World(plane(parcel))
    assert world.pose[0] == pytest.approx([0.03, -0.01, 0.4])
    throw(world, (0.0, 0.0, 1.0))
    arm = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]]) @ [0.05, 0.02]
    assert world.twist[0] == pytest.approx([arm[1], -arm[0], 1.0])


@pytest.mark.parametrize("ideal", [True, False])
def test_a_parcel_carried_over_the_edge_tips_once(ideal):
    world = World(plane(replace(BOX, x_m=0.2), wheel=(Wheel(0.0),)))
    for _ in range(3000):
        if ideal:
            world.step_ideal(np.full(18, 0.2), 1e-3)
        else:
            world.step_voltage(np.full(18, 0.5), 1e-3)
        if world.events:
            break
    (event,) = world.events
    assert (event.kind, event.parcel) == ("tip", "box")
    assert event.time_s == pytest.approx(world.time_s)
    assert world.pose[0, 0] == pytest.approx(2.5 * 0.127, abs=1e-3)
    world.step_ideal(np.full(18, 0.2), 1e-3)
    assert len(world.events) == 1


def test_cells_without_friction_in_a_mixed_array_only_carry():
    slippery = Patch(tuple(range(1, 19, 2)), friction=0.0)
    world = World(replace(plane(wheel=(Wheel(0.0),)), patch=(slippery,)))
    for _ in range(10):
        world.step_ideal(np.full(18, 5.0), 1e-3)
    assert world.normal_n[::2].any()
    assert not world.force_n[::2].any()
    assert world.twist[0, 0] == pytest.approx(
        0.3 * world.normal_n[1::2].sum() / 2.0 * 0.01, rel=0.01
    )


def test_a_parcel_rides_from_cells_of_one_kind_onto_cells_of_another():
    onward = Patch(tuple(c + 6 * r for r in range(3) for c in (4, 5, 6)), wheel=OMNI)
    world = World(replace(plane(replace(BOX, x_m=-0.15)), patch=(onward,)))
    assert len(world.wheels.cell) == 9 * 2 + 9 * 3
    reference = rigid_speed(world, (0.1, 0.0, 0.0)) / drive_of(world.scenario.cell).droop
    for _ in range(3000):
        world.step_ideal(reference, 1e-3)
    assert world.twist[0] == pytest.approx([0.1, 0.0, 0.0], abs=1e-9)
    assert world.pose[0, 0] > 0.1
