"""A batch of tables does what each does alone, to the last bit."""

from dataclasses import replace

import numpy as np
import pytest
from tests.sim_bus.physics.tables import BOX, plane, throw

from mdms_model.errors import InputError
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import Parcel, Patch, Wheel
from mdms_sim.physics.plane import handling
from mdms_sim.physics.plane.batch import Batch
from mdms_sim.physics.plane.world import World

STEP_S = 1e-3
HEXAGON = tuple((0.15 * np.cos(angle), 0.15 * np.sin(angle)) for angle in np.arange(6) * np.pi / 3)
SHAPES = (
    replace(BOX, name="a"),
    Parcel("a", 1.0, 0.28, 0.28, shape="disc"),
    Parcel("a", 1.7, 0.30, 0.30, shape="polygon", corners_m=HEXAGON),
)


def tables(count, seed=1):
    """Two parcels each of random outlines, masses, places and twists, on motors that differ."""
    chance, scenarios, twists = np.random.default_rng(seed), [], []
    for _ in range(count):
        cell = {
            "friction": chance.uniform(0.1, 0.5),
            "motor_spread": 0.1,
            "rotor_inertia_kg_m2": chance.uniform(0.0, 4e-6),
        }
        two = [
            replace(
                SHAPES[chance.integers(3)],
                name=name,
                x_m=x_m + chance.uniform(-0.03, 0.03),
                y_m=chance.uniform(-0.06, 0.06),
                yaw_rad=chance.uniform(-3, 3),
                mass_kg=chance.uniform(0.5, 3.0),
            )
            for name, x_m in (("a", -0.2), ("b", 0.18))
        ]
        table = plane(*two, **cell)
        scenarios.append(replace(table, run=replace(table.run, seed=int(chance.integers(1000)))))
        twists.append(chance.uniform(-0.5, 0.5, (2, 3)))
    return scenarios, twists


def thrown(worlds, twists):
    for world, two in zip(worlds, twists, strict=True):
        throw(world, *two)
    return worlds


def seen(world):
    """All that can be seen of a world, but the time."""
    scene = world.scene
    arrays = [*scene.state, *scene.scratch, *world.motion, world.presence()]
    events = [(each.kind, each.detail, each.parcel) for each in world.events]
    return b"".join(np.ascontiguousarray(array).tobytes() for array in arrays), events


@pytest.mark.parametrize("threads", [1, 2])
def test_each_table_of_a_batch_does_what_it_does_alone_to_the_last_bit(threads):
    scenarios, twists = tables(24)
    alone = thrown([World(scenario) for scenario in scenarios], twists)
    batch = Batch(scenarios, threads=threads)
    thrown(batch.worlds, twists)
    chance = np.random.default_rng(2)
    for _ in range(40):
        reference_m_s = chance.uniform(-0.3, 0.3, (len(scenarios), 36))
        batch.step_ideal(reference_m_s, STEP_S, steps=10)
        for world, own_m_s in zip(alone, reference_m_s, strict=True):
            for _ in range(10):
                world.step_ideal(own_m_s, STEP_S)
    for one, other in zip(batch.worlds, alone, strict=True):
        assert seen(one) == seen(other)
        assert one.time_s == pytest.approx(other.time_s)
        np.testing.assert_allclose(
            [event.time_s for event in one.events], [event.time_s for event in other.events]
        )
    kinds = {event.kind for world in alone for event in world.events}
    assert {"touch", "tip"} <= kinds


def test_single_steps_have_the_same_times_too():
    scenarios, twists = tables(5, seed=3)
    alone = thrown([World(scenario) for scenario in scenarios], twists)
    batch = Batch(scenarios)
    thrown(batch.worlds, twists)
    for _ in range(200):
        batch.step_ideal(np.full((5, 36), 0.1), STEP_S)
        for world in alone:
            world.step_ideal(np.full(36, 0.1), STEP_S)
    assert [each.time_s for each in batch.worlds] == [each.time_s for each in alone]
    assert [each.events for each in batch.worlds] == [each.events for each in alone]


def test_results_of_all_tables_are_those_of_each():
    scenarios, twists = tables(6)
    batch = Batch(scenarios)
    thrown(batch.worlds, twists)
    handling.take_away(batch.worlds[4].scene, 1)
    batch.step_ideal(np.full((6, 36), 0.2), STEP_S, steps=20, sensed=20)
    pose, twist = batch.motion
    for k, world in enumerate(batch.worlds):
        np.testing.assert_array_equal(pose[k], world.pose)
        np.testing.assert_array_equal(twist[k], world.twist)
        np.testing.assert_array_equal(batch.wheel_speed_m_s[k], world.wheel_speed_m_s)
        np.testing.assert_array_equal(batch.presence[k], world.presence())
    assert np.isnan(pose[4, 1]).all()


def test_sensors_are_read_after_the_step_that_is_asked_for():
    batch, world = Batch([plane(BOX)]), World(plane(BOX))
    for each in (batch.worlds[0], world):
        throw(each, (2.0, 0.0, 0.0))
    batch.step_ideal(np.full((1, 36), 1.0), STEP_S, steps=60, sensed=20)
    readings = []
    for _ in range(60):
        world.step_ideal(np.full(36, 1.0), STEP_S)
        readings.append(world.presence())
    np.testing.assert_array_equal(batch.presence[0], readings[19])
    assert (readings[19] != readings[59]).any()
    batch.sense()
    np.testing.assert_array_equal(batch.presence[0], readings[59])


def test_a_table_of_a_batch_goes_back_and_leaves_the_others_as_they_are():
    scenarios, twists = tables(3)
    batch = Batch(scenarios)
    thrown(batch.worlds, twists)
    state, drive = batch.worlds[1].state(), np.full((3, 36), 0.15)
    batch.step_ideal(drive, STEP_S, steps=100)
    first = [world.pose.copy() for world in batch.worlds]
    batch.worlds[1].restore(state)
    batch.step_ideal(drive, STEP_S, steps=100)
    np.testing.assert_array_equal(batch.worlds[1].pose, first[1])
    assert (batch.worlds[0].pose != first[0]).any()


def test_a_table_takes_the_place_of_another():
    scenarios, _ = tables(4)
    batch, world = Batch(scenarios[:3], most_edges=12), World(scenarios[3])
    batch.step_ideal(np.full((3, 36), 0.1), STEP_S, steps=50)
    batch.replace(2, scenarios[3])
    batch.step_ideal(np.full((3, 36), 0.1), STEP_S, steps=50)
    for _ in range(50):
        world.step_ideal(np.full(36, 0.1), STEP_S)
    assert seen(batch.worlds[2]) == seen(world)


def test_exits_take_parcels_as_in_a_world_alone():
    sort = load_scenario("sort54")
    batch, world = Batch([sort, sort]), World(sort)
    drive = np.tile([0.3, 0.0], 54)
    for _ in range(500):
        batch.step_ideal(np.array([drive, -drive]), STEP_S, steps=10)
        for _ in range(10):
            world.step_ideal(drive, STEP_S)
    kinds = [event.kind for event in batch.worlds[0].events]
    assert {"arrival", "exit"} <= {*kinds}
    assert kinds[:6] == [event.kind for event in world.events][:6]
    assert kinds != [event.kind for event in batch.worlds[1].events]


def test_tables_are_alike_by_the_wheels_of_each_cell():
    def patched(**patch):
        return replace(plane(BOX), patch=(Patch(**patch),))

    one_wheel = (Wheel(0.0, (-0.03, 0.0)),)
    with pytest.raises(InputError, match=r"table 1: its cell\.wheel differs"):
        Batch([patched(cells=(1,), wheel=one_wheel), patched(cells=(9,), wheel=one_wheel)])
    rough, both = patched(cells=(9,), friction=0.05), Batch([plane(BOX), plane(BOX)])
    world = both.replace(1, rough)
    alone = World(rough)
    drive = np.full(len(alone.wheels.cell), 0.3)
    both.step_ideal(np.array([drive, drive]), STEP_S, steps=20)
    for _ in range(20):
        alone.step_ideal(drive, STEP_S)
    assert (world.pose == alone.pose).all()
    assert (both.worlds[0].pose != alone.pose).any()


def test_tables_of_different_shapes_are_refused():
    with pytest.raises(InputError, match="table 1: its array differs from that of the first table"):
        Batch([plane(BOX), plane(BOX, columns=5)])
    with pytest.raises(InputError, match="table 1: its number of parcels differs"):
        Batch([plane(BOX), plane(BOX, replace(BOX, name="b", x_m=0.2))])
    batch = Batch([plane(BOX)])
    world = batch.worlds[0]
    with pytest.raises(InputError, match="table 0: its array differs from that of the first table"):
        batch.replace(0, plane(BOX, columns=5))
    assert batch.worlds[0] is world
    with pytest.raises(InputError, match="there are none"):
        Batch([])


def test_an_outline_without_room_is_refused_with_the_room_that_it_needs():
    hexagon = replace(SHAPES[2], name="box")
    batch = Batch([plane(BOX)])
    with pytest.raises(InputError, match="6 edges, but the batch has room for 4; give most_edges"):
        batch.replace(0, plane(hexagon))
