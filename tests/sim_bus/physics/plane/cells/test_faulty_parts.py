"""Jammed wheels, reversed motors, stuck encoders and sensors, as cells and parcels meet them."""

from dataclasses import replace

import numpy as np
import pytest

from mdms_model.scenario.file import load_scenario
from mdms_sim.physics.plane.world import World

CELLS = 18
#: All motors along x at 6 V.
DRIVEN = np.full((CELLS, 2), 6_000_000, np.int32) * np.array([1, 0], np.int32)
#: Cell 9 lies under the middle of the box; cell 1 at a corner of the table, under nothing.
UNDER, FREE = 8, 0


def table(**cell) -> World:
    """The demo's box in the middle of the table, motors without spread."""
    scenario = load_scenario("array18", ["parcel.0.x_m=0", "parcel.0.y_m=0"])
    cell = replace(scenario.cell, motor_spread=0.0, friction_spread=0.0, **cell)
    return World(replace(scenario, cell=cell))


def drive(world: World, steps: int = 400, voltage_uv=DRIVEN) -> None:
    for _ in range(steps):
        world.step_cells(voltage_uv, 1e-3)


def wheel(world: World, cell: int) -> int:
    return int(world.wheels.first[cell])


def set_fault(world: World, cell: int, name: str, value: int = 1) -> None:
    world.scene.state.wheels[name][wheel(world, cell)] = value


def test_a_jammed_wheel_stands_whatever_the_voltage_and_its_motor_draws_the_current_of_a_stall():
    world = table()
    drive(world)
    set_fault(world, FREE, "jammed")
    stood_m, count = world.wheel_travel_m[wheel(world, FREE)], world.sampled.counts[FREE, 0]
    for volts in (6, -12, 18):
        drive(world, 50, DRIVEN // 6 * np.int32(volts))
        assert world.wheel_speed_m_s[wheel(world, FREE)] == 0.0
        stall_a = volts / world.scenario.cell.resistance_ohm
        limit_a = world.scenario.cell.current_limit_a or np.inf
        stall_a = np.clip(stall_a, -limit_a, limit_a)
        assert world.sampled.current_ma[FREE, 0] == pytest.approx(1e3 * stall_a, rel=0.01)
    assert world.wheel_travel_m[wheel(world, FREE)] == stood_m
    assert world.sampled.counts[FREE, 0] == count
    set_fault(world, FREE, "jammed", 0)
    drive(world, 50)
    assert world.wheel_speed_m_s[wheel(world, FREE)] > 0.1


@pytest.mark.parametrize("volts", [0, 6])
def test_a_parcel_on_jammed_wheels_alone_is_held_by_friction_and_stops(volts):
    world = table()
    drive(world)
    start_m, start_m_s = world.pose[0, 0], world.twist[0, 0]
    assert start_m_s > 0.2
    world.scene.state.wheels["jammed"][:] = 1
    drive(world, 800, DRIVEN // 6 * np.int32(volts))
    # It slides to rest on half of its weight, that on the wheels along x; the rest is the give of
    # the jam.
    assert np.abs(world.twist[0]).max() < 1e-6
    slowing_m_s2 = world.scenario.cell.friction * world.scenario.run.gravity_m_s2 / 2
    slid_m = start_m_s**2 / (2 * slowing_m_s2)
    assert world.pose[0, 0] - start_m == pytest.approx(slid_m, rel=0.05)


def test_one_jammed_wheel_brakes_the_parcel_by_no_more_than_its_friction():
    free, jammed = table(), table()
    set_fault(jammed, UNDER, "jammed")
    for world in (free, jammed):
        drive(world)
    assert 0.0 < jammed.pose[0, 0] < free.pose[0, 0]
    pushed_n = jammed.force_n[wheel(jammed, UNDER)]
    limit_n = jammed.scenario.cell.friction * jammed.normal_n[wheel(jammed, UNDER)]
    assert pushed_n == pytest.approx(-limit_n)


def test_a_reversed_motor_turns_the_other_way_and_its_encoder_says_so():
    world, well = table(), table()
    set_fault(world, FREE, "reversed")
    for each in (world, well):
        drive(each)
    assert world.wheel_speed_m_s[wheel(world, FREE)] == pytest.approx(
        -well.wheel_speed_m_s[wheel(well, FREE)]
    )
    assert world.sampled.counts[FREE, 0] == pytest.approx(-well.sampled.counts[FREE, 0], abs=1)
    # The bridge measures its own current, in its own direction.
    assert world.sampled.current_ma[FREE, 0] == well.sampled.current_ma[FREE, 0]


def test_a_stuck_encoder_keeps_its_count_and_goes_on_from_there():
    world, well = table(), table()
    for each in (world, well):
        drive(each, 100)
    kept = world.sampled.counts[FREE, 0]
    set_fault(world, FREE, "encoder_stuck")
    for _ in range(100):
        drive(world, 1)
        assert world.sampled.counts[FREE, 0] == kept
    drive(well, 100)
    missed = well.sampled.counts[FREE, 0] - kept
    assert missed > 100
    set_fault(world, FREE, "encoder_stuck", 0)
    for each in (world, well):
        drive(each, 100)
    assert well.sampled.counts[FREE, 0] - world.sampled.counts[FREE, 0] == pytest.approx(
        missed, abs=1
    )
    assert world.pose.tobytes() == well.pose.tobytes()


def test_stuck_sensors_read_as_they_are_stuck_and_no_others_do():
    world, well = table(sensor_noise=0.1), table(sensor_noise=0.1)
    world.stuck_sensors[1, FREE, 2] = 1
    world.stuck_sensors[0, UNDER, [0, 1, 2, 3, 4]] = 1
    seen = np.array([world.presence() for _ in range(200)])
    truth = np.array([well.presence() for _ in range(200)])
    assert (seen[:, FREE] == truth[:, FREE] | 4).all()
    assert (seen[:, UNDER] == 0).all()
    others = [cell for cell in range(CELLS) if cell not in (FREE, UNDER)]
    assert (seen[:, others] == truth[:, others]).all()
    world.stuck_sensors[:] = 0
    assert np.array_equal(world.presence(), well.presence())


def test_a_world_goes_back_with_all_that_was_wrong_with_it():
    world = table()
    set_fault(world, UNDER, "jammed")
    set_fault(world, FREE, "encoder_stuck")
    set_fault(world, 1, "reversed")
    world.stuck_sensors[1, FREE] = 1
    drive(world, 100)
    state = world.state()

    def lived():
        drive(world, 100)
        return world.pose.tobytes(), world.sampled.counts.tobytes(), world.presence().tobytes()

    first = lived()
    for name in ("jammed", "encoder_stuck", "reversed"):
        world.scene.state.wheels[name] = 0
    world.stuck_sensors[:] = 0
    assert lived() != first
    world.restore(state)
    assert lived() == first
