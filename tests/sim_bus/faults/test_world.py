"""Faults of the world and of the host: their traces on the bus and in the record."""

import numpy as np
import pytest
from tests.sim_bus.faults.life import Life

from mdms_model.scenario.fault import Fault
from mdms_protocol import pdo
from mdms_protocol.codecs import cob

#: The bits of cells 1 and 3 for the box over cell 2: it reaches over their nearer sensors.
BESIDE = 0b10010


def presence(life, cell):
    """The reports of a cell about its sensors, as (time [s], bits)."""
    can_id = pdo.STATUS.can_id(cell)
    frames = ((now_s, frame) for now_s, frame in life.tool.heard if frame.can_id == can_id)
    return [(now_s, pdo.STATUS.decode(frame.data)[2]) for now_s, frame in frames]


def bits_at(life, cell, time_s):
    """The presence bits that a cell has reported last by some time."""
    return [bits for now_s, bits in presence(life, cell) if now_s <= time_s][-1]


def test_the_cell_reports_a_stuck_sensor_until_it_is_well():
    covered = Fault("sensor_stuck", start_s=1.0, duration_s=0.5, cells=(1,), sensors=(2, 3))
    free = Fault("sensor_stuck", start_s=1.0, duration_s=0.5, cells=(2,), covered=False)
    life = Life(covered, free)
    assert [bits_at(life, 1, time_s) for time_s in (0.9, 1.4, 1.9)] == [BESIDE, 0b11110, BESIDE]
    assert [bits_at(life, 2, time_s) for time_s in (0.9, 1.4, 1.9)] == [0b11111, 0, 0b11111]
    assert life.events == [
        (1.0, "sensor_stuck begins: sensor 2, 3 covered", 1),
        (1.0, "sensor_stuck begins: sensor 0, 1, 2, 3, 4 free", 2),
        (1.5, "sensor_stuck ends", 1),
        (1.5, "sensor_stuck ends", 2),
    ]


def test_a_sensor_that_two_faults_hold_is_well_when_both_have_ended():
    first = Fault("sensor_stuck", start_s=0.5, duration_s=0.5, cells=(1,), sensors=(0,))
    second = Fault("sensor_stuck", start_s=0.8, duration_s=0.8, sensors=(0,))
    life = Life(first, second)
    assert [bits_at(life, 1, time_s) for time_s in (0.4, 1.2, 1.9)] == [BESIDE, BESIDE | 1, BESIDE]


def test_bridges_that_two_faults_have_shut_off_work_when_both_have_ended():
    first = Fault("bridge_fault", start_s=0.2, duration_s=0.8, cells=(1,))
    life = Life(first, Fault("bridge_fault", start_s=0.4, duration_s=0.2), until_s=0.7)
    shut_off = life.simulation.world.bridges.shut_off
    assert [bool(each) for each in shut_off] == [True, False, False]
    life.simulation.run_until(1.1)
    assert not shut_off.any()


def test_a_parcel_is_lifted_and_set_down_on_other_cells():
    life = Life(Fault("lift", start_s=1.0, duration_s=0.5, parcel="box", x_m=-0.05, yaw_rad=0.1))
    assert [bits_at(life, 2, time_s) for time_s in (0.9, 1.4)] == [0b11111, 0]
    assert bits_at(life, 1, 1.4) == 0
    assert bits_at(life, 1, 1.9) != 0
    record = life.outcome.record
    np.testing.assert_allclose(record.pose[-1, 0], (-0.05, 0.0, 0.1), atol=1e-6)
    assert life.events == [
        (1.0, "lift begins", None),
        (1.5, "lift ends: set down at x -0.0500 m, y 0.0000 m, yaw 0.1000 rad", None),
    ]
    assert [event.parcel for event in record.events if event.kind == "fault"] == ["box", "box"]


def test_a_parcel_that_is_lifted_for_good_is_never_back():
    life = Life(Fault("lift", start_s=1.0, parcel="box"))
    assert bits_at(life, 2, 1.9) == 0
    assert len(life.events) == 1


def test_a_push_moves_the_parcel_and_one_in_the_air_does_not():
    push = Fault("push", start_s=1.0, parcel="box", impulse_n_s=(0.3, 0.0), twist_nms=0.001)
    lifted = Fault("lift", start_s=0.9, duration_s=0.2, parcel="box")
    # It rests on all three cells, and does not tip on its way.
    pushed, held = Life(push, length_m=0.3), Life(lifted, push, length_m=0.3)
    x_m, y_m, yaw_rad = pushed.outcome.record.pose[-1, 0]
    assert x_m > 5e-3
    assert abs(y_m) < 1e-3
    assert yaw_rad > 1e-3
    assert pushed.events == [(1.0, "push begins: 0.3, 0 N s and 0.001 N m s", None)]
    assert (1.0, "push begins: it is lifted, and not pushed", None) in held.events
    assert (held.outcome.record.pose[-1, 0] == 0.0).all()


@pytest.mark.parametrize("kind", ["wheel_jammed", "motor_reversed", "encoder_stuck"])
def test_a_fault_of_a_wheel_is_told_with_its_axis(kind):
    life = Life(Fault(kind, start_s=0.5, duration_s=0.5, cells=(1, 3), axes=(2,)), until_s=1.1)
    assert life.events == [
        (0.5, f"{kind} begins: axis 2", 1),
        (0.5, f"{kind} begins: axis 2", 3),
        (1.0, f"{kind} ends", 1),
        (1.0, f"{kind} ends", 3),
    ]
    assert (life.simulation.world.scene.state.wheels["jammed"] == 0).all()


def test_wheels_without_axes_named_are_all_of_the_cells():
    life = Life(Fault("wheel_jammed", start_s=0.5, cells=(2,)), until_s=0.6)
    assert life.simulation.world.scene.state.wheels["jammed"].tolist() == [0, 0, 1, 1, 0, 0]


def test_a_host_that_is_gone_neither_sends_nor_receives_until_it_is_back():
    life = Life(Fault("host", start_s=1.0, duration_s=0.5))
    # A cell sends its speeds at the host's SYNC.
    assert [life.speeds(cell, 1.001, 1.5) for cell in (1, 2, 3)] == [0, 0, 0]
    assert not [now_s for now_s, _ in life.tool.heard if 1.001 < now_s < 1.5]
    assert [life.speeds(cell, 1.52, 2.0) for cell in (1, 2, 3)] == [48, 48, 48]
    assert life.events == [(1.0, "host begins", None), (1.5, "host ends", None)]
    # The cells go on by themselves: who listens besides gets their heartbeats.
    assert life.outcome.bus.errors == 0
    assert life.tool.times(cob.HEARTBEAT_BASE + 1)[-1] > 1.5
