"""The rules about parcels: one parcel a cell, and parcels apart."""

from dataclasses import replace

import numpy as np
import pytest
from tests.sim_bus.referee.stand_ins import (
    ABOUT_WHEELS,
    NEAR,
    PROMISED,
    REST,
    UNDER,
    along_x,
    estimate,
    every,
    judged,
    noted,
    page,
    table,
)

from mdms_model.array import cell_centres
from mdms_model.run.record import Event
from mdms_model.scenario.fault import Fault
from mdms_model.scenario.scenario import Stream
from mdms_protocol.neighbours import messages
from mdms_sim.physics.plane.world import World
from mdms_sim.referee import parcels
from mdms_sim.referee.truth import HostReport
from mdms_sim.referee.watch import NOBODY, SEVERAL, Shapes, find_parcels

pytestmark = pytest.mark.violates(*ABOUT_WHEELS)

#: Two boxes beside each other along x, 0.1 m apart, on cells 8, 9 and 10, 11.
LEFT, RIGHT = (-0.2, 0.0), (0.1, 0.0)
PLACES = [(0.1, page(messages.Place, 1, *LEFT)), (0.1, page(messages.Place, 2, *RIGHT))]
OFF_1 = '{kind="off", start_s=0.05, cells=[1]}'
STOP = '{{kind="supply", start_s={}, supply_v=0}}'


@pytest.mark.violates("one_parcel")
def test_a_cell_that_promises_itself_to_two_within_a_lease_is_noted():
    frames = [*PLACES, (0.5, estimate(10, 1, PROMISED)), (0.55, estimate(10, 2, UNDER))]
    (violation,) = noted(judged(table(LEFT, RIGHT), 0.7, frames=frames))
    assert violation == ("one_parcel", pytest.approx(0.55, abs=0.001), 10, "box2")


def test_a_promise_after_the_lease_and_one_that_is_taken_back_are_allowed():
    frames = [
        *PLACES,
        (0.5, estimate(10, 1, PROMISED)),
        (0.52, estimate(10, 2, NEAR)),
        (0.59, estimate(10, 2, PROMISED)),
        (0.6, estimate(9, 1, UNDER)),
    ]
    assert not noted(judged(table(LEFT, RIGHT), 0.7, frames=frames))


def driven_under(identity):
    """Cell 11, on which the right box lies alone, drives, and says for whom."""
    frames = [*PLACES, *every(0.01, 0.5, 1.2, estimate(11, identity, UNDER))]
    drive = lambda time_s: along_x(3.0, [10, 11]) if 0.5 <= time_s < 0.9 else REST  # noqa: E731
    return noted(judged(table(LEFT, RIGHT), 1.2, drive=drive, frames=frames))


@pytest.mark.violates("one_parcel")
def test_a_cell_that_drives_for_one_parcel_under_another_is_noted():
    (violation,) = driven_under(identity=1)
    assert violation == ("one_parcel", pytest.approx(0.85, abs=0.06), 11, "box2")


def test_a_cell_that_drives_for_the_parcel_over_it_is_not():
    assert not driven_under(identity=2)


def steered(*names):
    """A host that steers these boxes to where they are, and others nowhere."""
    return lambda _: HostReport(goals=dict.fromkeys(names, (0.0, 0.0, None)))


@pytest.mark.violates("one_parcel")
def test_wheels_under_a_parcel_that_the_host_does_not_steer_are_to_stand():
    drive = lambda time_s: along_x(3.0, [10, 11]) if time_s < 0.5 else REST  # noqa: E731
    violations = noted(judged(table(LEFT, RIGHT), 0.7, drive=drive, host=steered("box1")))
    assert violations == [("one_parcel", pytest.approx(0.4, abs=0.06), 11, "box2")]
    assert not noted(judged(table(LEFT, RIGHT), 0.7, drive=drive, host=steered("box1", "box2")))


def towards(time_s):
    """The left box is driven into the right one."""
    return along_x(2.0, [7, 8, 9])


@pytest.mark.violates("apart")
def test_a_parcel_that_is_driven_into_another_is_noted():
    simulation = judged(table(LEFT, RIGHT), 1.0, drive=towards)
    (touch,) = [each for each in simulation.world.events if each.kind == "touch"]
    assert noted(simulation) == [("apart", pytest.approx(touch.time_s, abs=0.011), None, "box1")]
    assert not simulation.referee.unavoidable


@pytest.mark.violates("apart")
def test_a_fault_long_before_does_not_excuse_a_parcel_that_is_driven_on():
    violations = noted(judged(table(LEFT, RIGHT, faults=[OFF_1]), 1.0, drive=towards))
    assert [(rule, parcel) for rule, _, _, parcel in violations] == [("apart", "box1")]


def lifted(boxes):
    return replace(boxes, fault=(Fault("lift", start_s=0.3, parcel="box3"),))


def coming(boxes):
    """The third box is set down by a stream."""
    *others, third = boxes.parcel
    return replace(
        boxes,
        parcel=(*others, replace(third, goal=None)),
        stream=(Stream(x_m=third.x_m, parcels=("box3",), start_s=0.3),),
        motion=replace(boxes.motion, field="program"),
    )


@pytest.mark.violates("apart")
@pytest.mark.parametrize("moved_by_hand", [lifted, coming])
def test_a_hand_on_another_parcel_just_before_excuses_no_touch(moved_by_hand):
    def into_each_other(time_s):
        return along_x(2.0, [7, 8]) + along_x(-2.0, [9, 10])

    boxes = moved_by_hand(table((-0.24, 0.0), (0.04, 0.0), (0.33, 0.0)))
    violations = noted(judged(boxes, 0.6, drive=into_each_other))
    assert [(rule, parcel) for rule, _, _, parcel in violations] == [("apart", "box1")]


def test_a_touch_while_all_coast_after_an_emergency_stop_is_unavoidable():
    """7 cm are left at 0.3 s, and nothing brakes motors that have no supply."""
    simulation = judged(table(LEFT, RIGHT, faults=[STOP.format(0.3)]), 1.0, drive=towards)
    (touch,) = [each for each in simulation.world.events if each.kind == "touch"]
    assert touch.time_s > 0.3
    assert simulation.referee.unavoidable == [touch]


def test_a_parcel_pushed_into_another_or_set_down_on_it_is_the_hands_doing():
    push = '{kind="push", start_s=0.2, parcel="box1", impulse_n_s=[1.5, 0.0]}'
    lift = '{kind="lift", start_s=0.2, duration_s=0.3, parcel="box1", x_m=-0.05}'
    for fault in (push, lift):
        simulation = judged(table(LEFT, RIGHT, faults=[fault]), 1.5)
        assert [each.kind for each in simulation.referee.unavoidable] == ["touch"]


@pytest.mark.violates("apart")
def test_a_pushed_parcel_is_the_hands_until_it_rests_unless_wheels_drive_it(monkeypatch):
    monkeypatch.setattr(parcels, "_HANDLED_S", 0.3)
    push = '{kind="push", start_s=0.2, parcel="box1", impulse_n_s=[0.4, 0.0]}'
    rolling = judged(table(LEFT, RIGHT, faults=[push]), 2.0)
    assert [each.kind for each in rolling.referee.unavoidable] == ["touch"]
    assert not noted(rolling)
    driven = judged(
        table(LEFT, RIGHT, faults=[push]),
        2.0,
        drive=lambda time_s: along_x(1.0 if time_s > 0.4 else 0.0, [7, 8, 9]),
    )
    assert [(rule, parcel) for rule, _, _, parcel in noted(driven)] == [("apart", "box1")]


@pytest.mark.violates("apart")
def test_a_parcel_that_is_driven_off_the_table_is_noted_and_one_that_is_pushed_off_is_not():
    driven = judged(table(LEFT), 3.0, drive=lambda _: along_x(-6.0))
    (event,) = [each for each in driven.world.events if isinstance(each, Event)]
    assert event.kind == "tip"
    assert noted(driven) == [("apart", pytest.approx(event.time_s, abs=0.011), None, "box1")]
    push = '{kind="push", start_s=0.2, parcel="box1", impulse_n_s=[-4.0, 0.0]}'
    pushed = judged(table(LEFT, faults=[push]), 2.0)
    assert [each.kind for each in pushed.referee.unavoidable] == ["tip"]
    assert not noted(pushed)


def test_an_open_loop_field_promises_no_distance():
    more = ["motion.field=inward", "motion.speed_m_s=0.1"]
    simulation = judged(table(LEFT, RIGHT, more=more), 1.0, drive=towards)
    assert [each.kind for each in simulation.world.events] == ["touch"]
    assert not noted(simulation)


def test_a_square_under_two_parcels_is_of_neither():
    scenario = table((-0.19, 0.0), (0.09, 0.0))
    model, state = (scene := World(scenario).scene).model, scene.state
    shapes = Shapes(model.parcels, state.parcels, model.edges, cell_centres(scenario.array))
    found = np.zeros(18, dtype=np.int64)
    find_parcels(shapes, scenario.array.pitch_m / 2, found)
    assert found[6:12].tolist() == [0, 0, SEVERAL, 1, 1, NOBODY]
