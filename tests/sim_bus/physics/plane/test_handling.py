"""Parcels that hands push, lift and set down again."""

from dataclasses import replace

import numpy as np
import pytest
from tests.sim_bus.physics.tables import BOX, plane, rigid_speed, throw

from mdms_model.scenario.scenario import Exit, Parcel, Stream
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


STEP_S = 2e-3
STOCK = (
    *(Parcel(f"box {number}", 2.0, 0.30, 0.28, kind="box") for number in (1, 2)),
    *(Parcel(f"disc {number}", 1.5, 0.30, 0.30, shape="disc", kind="disc") for number in (1, 2)),
)
STREAM = Stream(tuple(parcel.name for parcel in STOCK), x_m=-0.2)
EAST = Exit("out", "east")


def flow(world, seconds, speed_m_s=0.4):
    """All wheels carry along x."""
    references = rigid_speed(world, (speed_m_s, 0.0, 0.0)) * 1.29
    for _ in range(round(seconds / STEP_S)):
        world.step_ideal(references, STEP_S)


def streaming(*exits, stream=STREAM, parcels=STOCK, seed=1):
    scenario = replace(plane(*parcels), stream=(stream,), exit=exits)
    return World(replace(scenario, run=replace(scenario.run, seed=seed)))


def log(world, *kinds):
    return [(event.kind, event.parcel) for event in world.events if event.kind in kinds]


def test_a_parcel_in_stock_is_nowhere_and_covers_no_sensor():
    world = streaming(stream=replace(STREAM, start_s=1.0))
    flow(world, 0.5)
    assert np.isnan(world.pose).all()
    assert np.isnan(world.twist).all()
    assert not world.presence().any()
    assert (world.normal_n == 0.0).all()


def test_parcels_are_set_down_at_rest_as_soon_as_the_place_is_free():
    world = streaming(EAST)
    flow(world, STEP_S)
    first = int(np.flatnonzero(np.isfinite(world.pose[:, 0]))[0])
    assert world.pose[first] == pytest.approx((-0.2, 0.0, 0.0))
    assert world.twist[first] == pytest.approx(np.zeros(3))
    flow(world, 3.0)
    comings = [event.time_s for event in world.events if event.kind == "arrival"]
    assert len(comings) >= 3
    # It takes some 0.8 s to carry 0.32 m at 0.4 m/s.
    assert 0.6 < min(np.diff(comings)) < max(np.diff(comings)) < 1.1
    assert not log(world, "touch", "tip")


def test_a_parcel_leaves_when_its_centre_has_passed_the_last_support_and_comes_again():
    world = streaming(EAST, parcels=STOCK[:1], stream=replace(STREAM, parcels=("box 1",)))
    flow(world, 4.0)
    assert log(world, "arrival", "exit")[:3] == [
        ("arrival", "box 1"),
        ("exit", "box 1"),
        ("arrival", "box 1"),
    ]
    assert not log(world, "tip")
    last_m = world.wheels.position_m[:, 0].max()
    leaving = next(event for event in world.events if event.kind == "exit")
    assert leaving.detail == "leaves by out"
    # 0.4 m/s from -0.2 m on, after it has come up to speed.
    assert leaving.time_s == pytest.approx((last_m + 0.2) / 0.4, abs=0.25)


def test_without_an_exit_there_it_tips():
    for exits in ((), (Exit("out", "north"),), (Exit("out", "east", from_m=0.1),)):
        world = streaming(*exits, stream=replace(STREAM, most=1))
        flow(world, 3.0)
        assert [kind for kind, _ in log(world, "exit", "tip")] == ["tip"]


def test_a_parcel_of_another_kind_leaves_too_and_the_record_says_so():
    only = replace(STREAM, parcels=("disc 1",), most=1)
    world = streaming(replace(EAST, kinds=("box",)), stream=only, parcels=STOCK[2:3])
    flow(world, 3.0)
    assert [event.detail for event in world.events if event.kind == "exit"] == [
        "leaves by out, which is not for its kind"
    ]


def test_no_more_come_than_are_to_and_not_sooner_than_the_period():
    world = streaming(EAST, stream=replace(STREAM, most=2, period_s=1.8, start_s=0.5))
    flow(world, 5.0)
    comings = [event.time_s for event in world.events if event.kind == "arrival"]
    assert comings == pytest.approx([0.5, 2.3], abs=STEP_S)


def test_nothing_is_set_down_beside_a_parcel_that_stands_in_the_way():
    world = streaming(parcels=(*STOCK, replace(BOX, x_m=0.12)))
    flow(world, 0.5, speed_m_s=0.0)
    assert not log(world, "arrival")
    lift(world.scene, len(STOCK))
    set_down(world.scene, len(STOCK), 0.2, None, None)
    flow(world, 0.02, speed_m_s=0.0)
    assert len(log(world, "arrival")) == 1


def test_the_same_seed_brings_the_same_parcels_to_the_same_places():
    spread = replace(STREAM, spread_m=0.004, spread_rad=0.02)
    worlds = [streaming(EAST, stream=spread, seed=seed) for seed in (1, 1, 2)]
    for world in worlds:
        flow(world, 5.0)
    stories = [[(event.kind, event.parcel, event.detail) for event in w.events] for w in worlds]
    assert stories[0] == stories[1] != stories[2]
    assert len({parcel for kind, parcel, _ in stories[0] if kind == "arrival"}) > 1


def test_a_restored_world_brings_the_same_parcels_again():
    world = streaming(EAST, stream=replace(STREAM, spread_m=0.004))
    flow(world, 2.0)
    state = world.state()
    flow(world, 3.0)
    went_on, pose = repr(world.events), world.pose.tobytes()
    world.restore(state)
    flow(world, 3.0)
    assert (repr(world.events), world.pose.tobytes()) == (went_on, pose)


def test_at_a_corner_of_two_exits_that_edge_counts_which_is_passed():
    for east_first in (True, False):
        exits = (EAST, Exit("side", "north", kinds=("box",)))
        stream = replace(STREAM, y_m=0.001, most=1)
        world = streaming(*(exits if east_first else exits[::-1]), stream=stream)
        flow(world, 3.0)
        assert [event.detail for event in world.events if event.kind == "exit"] == ["leaves by out"]
