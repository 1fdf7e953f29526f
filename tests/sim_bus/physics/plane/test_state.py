"""A world that goes back does the same again, to the last bit; limits of the solver are events."""

from dataclasses import replace

import numpy as np
import pytest
from tests.sim_bus.physics.tables import BOX, plane, throw

from mdms_model.scenario.scenario import Parcel
from mdms_sim.physics.plane.world import World

STEP_S = 1e-3
NOISY = {
    "rotor_inertia_kg_m2": 2e-6,
    "motor_spread": 0.1,
    "sensor_noise": 0.1,
    "sensor_delay_s": 0.004,
    "load_cell_noise_n": 0.2,
}


def busy_world():
    """Two boxes that slide towards each other over a table of motors that differ."""
    world = World(
        plane(replace(BOX, name="a", x_m=-0.3), replace(BOX, name="b", x_m=0.12), **NOISY)
    )
    throw(world, (0.4, 0.05, 0.2), (-0.1, 0.0, -0.3))
    return world


def lived(world, steps, seed):
    """All that can be seen of a world over some steps under voltages by chance."""
    chance, seen = np.random.default_rng(seed), []
    for _ in range(steps):
        world.step_cells(chance.integers(-12_000_000, 12_000_000, (18, 2)), STEP_S)
        seen += [*world.motion, world.wheel_speed_m_s, world.wheel_travel_m, world.normal_n]
        seen += [world.force_n, world.slip_m_s, world.contact, world.motor_current_a]
        seen += [world.sampled.counts.copy(), world.sampled.current_ma.copy()]
        seen += [world.presence(), world.load_n()]
    return b"".join(each.tobytes() for each in seen), repr(world.events), world.time_s


def test_a_restored_world_does_the_same_again_to_the_last_bit():
    world = busy_world()
    lived(world, 150, seed=1)
    state = world.state()
    went_on = lived(world, 400, seed=2)
    assert "touches" in went_on[1]
    for _ in range(2):
        world.restore(state)
        assert lived(world, 400, seed=2) == went_on


def test_a_state_is_taken_without_a_trace():
    watched, other = busy_world(), busy_world()
    for seed in range(3):
        watched.state()
        assert lived(watched, 50, seed) == lived(other, 50, seed)


def test_a_restored_world_stands_as_it_did():
    world = busy_world()
    lived(world, 150, seed=1)
    state, stood = world.state(), [*world.motion, world.force_n, world.sampled.counts.copy()]
    world.bridges.supply_v[3] = 0.0
    lived(world, 20, seed=2)
    world.restore(state)
    for then, now in zip(stood, [*world.motion, world.force_n, world.sampled.counts], strict=True):
        np.testing.assert_array_equal(now, then)
    assert world.time_s == pytest.approx(0.15)
    assert world.bridges.supply_v[3] == 24.0


def test_the_ideal_law_goes_back_too():
    world = World(plane(BOX))
    reference = np.linspace(-0.1, 0.1, 36)
    state = world.state()
    ends = []
    for _ in range(2):
        world.restore(state)
        for _ in range(200):
            world.step_ideal(reference, STEP_S)
        ends.append(world.pose.tobytes())
    assert ends[0] == ends[1]


def heap(count):
    """Discs one in the other, which no table holds: more touches than there is room for."""
    disc = Parcel("0", 1.0, 0.2, 0.2, shape="disc")
    return World(
        plane(*(replace(disc, name=str(n), x_m=0.002 * n, y_m=0.0005 * n**2) for n in range(count)))
    )


def test_touches_without_room_are_an_event_once_as_long_as_it_lasts():
    world = heap(16)
    for _ in range(3):
        world.step_ideal(np.zeros(36), STEP_S)
    found = [event for event in world.events if event.kind == "solver"]
    dropped = [event for event in found if "found no room" in event.detail]
    assert len(dropped) == 1
    assert dropped[0].time_s == STEP_S
    assert "(24 in this step)" in dropped[0].detail  # 16 * 15 / 2 pairs, room for 6 * 16


def test_forces_that_are_not_found_in_the_rounds_allowed_are_an_event():
    world = heap(12)
    world.step_ideal(np.zeros(36), STEP_S)
    assert any("forces between parcels were not found" in event.detail for event in world.events)


def test_a_table_in_order_reaches_no_limit_of_the_solver():
    world = busy_world()
    lived(world, 500, seed=3)
    assert not [event for event in world.events if event.kind == "solver"]
