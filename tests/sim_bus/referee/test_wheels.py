"""Each rule about wheels finds its deliberate violation, at its cell and time."""

import pytest
from tests.sim_bus.referee.bench import CELLS, control, heartbeats, judge, write

from mdms_cell.canopen.nmt import Guard
from mdms_cell.cell import Cell
from mdms_cell.drive import speed_loop, tuning
from mdms_cell.drive.axes import TRANSITIONS, Drive
from mdms_model.scenario.fault import Fault
from mdms_protocol import indices
from mdms_protocol.codecs import cia402, cob, nmt
from mdms_protocol.codecs.frame import Frame

PUSH_UV = (3_000_000, 0)
#: A stop is seen to fail so much later [s].
SOON_S = 0.02


def of_all(violations, rule, from_s, to_s=None):
    """Whether all cells have broken a rule, none another, first within this time."""
    to_s = from_s + SOON_S if to_s is None else to_s
    assert {rule for rule, _, _ in violations} == {rule}
    assert {cell for _, cell, _ in violations} == set(range(1, CELLS + 1))
    assert from_s <= min(time_s for _, _, time_s in violations) <= to_s
    return True


# Nothing is wrong ---------------------------------------------------------------------------------


def stop_all(word):
    return [(1.0, control(node_id, word)) for node_id in range(1, CELLS + 1)]


@pytest.mark.parametrize(
    "doing",
    [
        {},
        {"silent_s": 1.0},
        {"silent_s": 0.0},
        {"more": [(1.0, nmt.command(nmt.STOP))]},
        {"more": [(1.0, nmt.command(nmt.RESET_NODE))]},
        {"more": stop_all(cia402.QUICK_STOP), "targets_um_s": (200_000, 0)},
        {"more": stop_all(cia402.DISABLE_VOLTAGE)},
        {"more": stop_all(cia402.SHUTDOWN)},
        {"more": stop_all(cia402.SWITCH_ON)},
        {"silent_s": 0.45, "targets_um_s": (1_000_000, 0)},
        {"silent_s": 1.0, "more": [(1.06, nmt.command(nmt.STOP))]},
        {"silent_s": 1.0, "more": [(1.0511, control(1, cia402.DISABLE_VOLTAGE))]},
    ],
)
def test_firmware_that_stops_as_documented_violates_nothing(doing):
    assert judge(**doing) == []


def test_frames_of_another_length_are_looked_at_as_others():
    watched = (cob.NMT, cob.SYNC, cob.PROGRAM, cob.SDO_REQUEST_BASE + 1, 0x201, 0x301)
    frames = [(0.2, Frame(can_id, bytes(size))) for can_id in watched for size in (0, 1)]
    assert judge(more=frames, until_s=0.3) == []


@pytest.mark.parametrize(
    "fault",
    [
        Fault("supply", start_s=1.0, duration_s=0.1, supply_v=0.0),
        Fault("supply", start_s=1.0, duration_s=0.1, supply_v=8.0),
        Fault("supply", start_s=1.0, duration_s=0.004, supply_v=8.0),
        Fault("bridge_fault", start_s=1.0, duration_s=0.2, cells=(1,)),
        Fault("off", start_s=1.0, duration_s=0.1, cells=(1,)),
        Fault("hang", start_s=1.0, duration_s=0.25, cells=(1,)),
        Fault("hang", start_s=0.7, cells=(1,)),
        Fault("wheel_jammed", start_s=1.0, cells=(1,)),
        Fault("motor_reversed", start_s=1.0, cells=(1,)),
        Fault("encoder_stuck", start_s=1.0, cells=(1,)),
        Fault("drift", start_s=0.6, cells=(1,), drift_ppm=-100_000),
        Fault("loss", start_s=1.0, duration_s=0.2),
    ],
    ids=lambda fault: f"{fault.kind} {fault.supply_v}",
)
@pytest.mark.parametrize("silent_s", [9.0, 1.2])
def test_firmware_with_this_fault_violates_nothing(fault, silent_s):
    assert judge(fault, silent_s=silent_s, targets_um_s=(100_000, 0)) == []


@pytest.mark.parametrize(
    "faults",
    [
        (
            Fault("hang", start_s=0.1, duration_s=0.8, cells=(1,)),
            Fault("off", start_s=0.12, duration_s=0.02, cells=(1,)),
        ),
        (
            Fault("drift", start_s=0.2, cells=(1,), drift_ppm=-100_000),
            Fault("drift", start_s=0.5, duration_s=0.1, drift_ppm=-50_000),
        ),
    ],
    ids=["an outage ends a hang", "a drift within another"],
)
def test_firmware_with_faults_at_once_violates_nothing(faults):
    assert judge(*faults, silent_s=1.0, targets_um_s=(100_000, 0)) == []


def test_supply_that_is_low_while_the_axes_are_off_is_no_fault_that_is_to_be_reset():
    fault = Fault("supply", start_s=0.1, duration_s=0.1, supply_v=8.0)
    assert judge(fault, until_s=0.6) == []


@pytest.mark.violates("heeded", "asked")
def test_a_cell_that_cannot_measure_a_low_supply_has_the_time_of_the_host_and_no_more():
    """The tool is no host that would switch the cell off, so it drives on."""
    fault = Fault("supply", start_s=1.0, duration_s=0.2, supply_v=8.0)
    violations = judge(fault, measures_high=2)
    assert {cell for _, cell, _ in violations} == {2}
    assert violations[0] == ("heeded", 2, pytest.approx(1.05, abs=0.005))
    soon = Fault("supply", start_s=1.0, duration_s=0.04, supply_v=8.0)
    assert judge(soon, measures_high=2) == []


# Asked --------------------------------------------------------------------------------------------


@pytest.mark.violates("asked")
def test_voltage_that_nobody_asked_for_after_power_up():
    assert judge(held=(2, 0.2, PUSH_UV), until_s=0.3) == [("asked", 2, pytest.approx(0.2))]


@pytest.mark.violates("asked")
def test_cell_that_drives_on_when_its_supply_is_back(monkeypatch):
    def forget(drive):
        drive.registers[drive.base + speed_loop.FAULTS] = 0
        return 0

    monkeypatch.setattr(Drive, "poll", forget)
    fault = Fault("supply", start_s=1.0, duration_s=0.1, supply_v=8.0)
    assert of_all(judge(fault), "asked", 1.1)


@pytest.mark.violates("asked")
@pytest.mark.parametrize(
    "fault",
    [
        Fault("loss", start_s=1.0, duration_s=0.1),
        Fault("supply", start_s=1.0, duration_s=0.1, supply_v=8.0),
    ],
    ids=lambda fault: fault.kind,
)
def test_cell_whose_fault_a_new_target_ends(monkeypatch, fault):
    """A state machine that latches nothing."""
    again = cia402.FAULT | cia402.ENABLE_OPERATION << 8
    monkeypatch.setitem(TRANSITIONS, again, cia402.OPERATION_ENABLED)
    word = cia402.ENABLE_OPERATION
    more = [(1.6, control(node_id, word)) for node_id in range(1, CELLS + 1)]
    violations = judge(fault, more=more, until_s=2.0)
    assert of_all(violations, "asked", 1.6)


@pytest.mark.violates("asked")
def test_cell_that_drives_after_a_reset_without_a_controlword():
    fault = Fault("off", start_s=1.0, duration_s=0.1, cells=(2,))
    violations = judge(fault, held=(2, 1.2, PUSH_UV), until_s=1.3)
    assert violations == [("asked", 2, pytest.approx(1.2))]


# Heeded -------------------------------------------------------------------------------------------


@pytest.mark.violates("heeded")
def test_cell_that_drives_on_after_nmt_stop(monkeypatch):
    follow = Cell.on_state

    def ignore(cell, state):
        if state != nmt.STOPPED:
            follow(cell, state)

    monkeypatch.setattr(Cell, "on_state", ignore)
    assert of_all(judge(more=[(1.0, nmt.command(nmt.STOP))], until_s=1.04), "heeded", 1.0)


@pytest.mark.violates("heeded")
@pytest.mark.parametrize(
    "word", [cia402.QUICK_STOP, cia402.DISABLE_VOLTAGE, cia402.SHUTDOWN, cia402.SWITCH_ON]
)
def test_cell_that_does_not_know_a_command_that_stops(monkeypatch, word):
    monkeypatch.delitem(TRANSITIONS, cia402.OPERATION_ENABLED | word << 8)
    assert of_all(judge(more=stop_all(word)), "heeded", 1.0, 1.05)


@pytest.mark.violates("heeded")
def test_bridge_that_goes_on_after_its_cell_has_reported_a_fault():
    """The wheel runs away from its setpoint of 0, which the cell sees after 80 ms."""
    violations = judge(targets_um_s=(0, 0), held=(2, 1.0, PUSH_UV), until_s=1.2)
    assert violations == [("heeded", 2, pytest.approx(1.09, abs=SOON_S))]


# Silent -------------------------------------------------------------------------------------------


@pytest.mark.violates("silent")
def test_setpoint_watchdog_that_is_late(monkeypatch):
    set_times = tuning.set_times

    def set_late(registers, timeout_ms, braking_ms):
        set_times(registers, timeout_ms + 150, braking_ms)

    monkeypatch.setattr(tuning, "set_times", set_late)
    assert of_all(judge(silent_s=1.0), "silent", 1.04, 1.1)


@pytest.mark.violates("silent")
def test_cell_that_does_not_miss_the_hosts_heartbeat(monkeypatch):
    watched = [
        (
            0.25 + 0.002 * node_id,
            write(node_id, indices.CONSUMER_TIMES, 1, cob.HOST_NODE << 16 | 75),
        )
        for node_id in range(1, CELLS + 1)
    ]
    more = [*watched, *heartbeats(0.3, 1.0)]
    assert judge(more=more) == []
    monkeypatch.setattr(Guard, "poll", lambda guard, now_ms: 1000)
    assert of_all(judge(more=more), "silent", 1.05, 1.12)


@pytest.mark.violates("silent")
def test_cell_that_hangs_for_longer_than_its_watchdog_waits():
    fault = Fault("hang", start_s=0.8, duration_s=1.0, cells=(2,))
    violations = judge(fault, held=(2, 0.8, PUSH_UV), until_s=1.6)
    assert violations == [("silent", 2, pytest.approx(1.301, abs=SOON_S))]


def test_watchdog_that_is_dead_too_is_no_fault_of_the_cell():
    fault = Fault("hang", start_s=0.8, cells=(2,))
    assert judge(fault, held=(2, 0.8, PUSH_UV), until_s=1.6) == []


# Quiet --------------------------------------------------------------------------------------------


@pytest.mark.violates("quiet")
def test_wheel_that_turns_where_no_parcel_is_and_nobody_asked():
    assert judge(targets_um_s=(0, 0), held=(6, 1.0, PUSH_UV), until_s=1.05) == [
        ("quiet", 6, pytest.approx(1.0, abs=SOON_S))
    ]


def test_wheel_that_turns_below_a_parcel_is_not_quiet_and_need_not_be():
    assert judge(targets_um_s=(0, 0), held=(1, 1.0, PUSH_UV), until_s=1.05) == []
