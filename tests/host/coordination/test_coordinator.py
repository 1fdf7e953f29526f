"""A run: parcels reach their goals, and what ends it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.host.coordination.arrays import BOTTOM, BOX, LAYOUT, STRICT, running, steering, still

from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.run_state import EVENTS_KEPT, EventJournal, Phase
from mdms_host.layout import Layout, WheelPlace
from mdms_host.motion.goal import GoalPose
from mdms_host.motion.program import FieldProgram
from mdms_host.page.events import advice_for
from mdms_protocol import pdo
from mdms_protocol.codecs import cia402, cob, nmt, sdo
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.entry import OutOfRangeError


@pytest.mark.parametrize(
    ("start", "goal", "seed"),
    [
        ((-0.10, 0.0, 0.0), (0.10, 0.0, np.pi / 6), 1),
        ((0.13, 0.02, 0.2), (-0.10, -0.01, -0.4), 2),
        ((-0.05, -0.02, -0.3), (0.0, 0.0, 0.5), 3),
    ],
)
def test_parcel_reaches_its_goal(rolling_array, start, goal, seed: int) -> None:
    coordinator = steering(GoalPose(*goal))
    array = rolling_array(
        LAYOUT, BOTTOM, start, speed_error=0.03, noise_m_s=0.002, latency_s=0.003, seed=seed
    )
    array.run(coordinator, 10.0, lambda: coordinator.finished)
    assert coordinator.finished
    error = array.pose - goal
    assert np.hypot(*error[:2]) < 0.005
    assert abs(error[2]) < np.radians(1.5)
    estimate = coordinator.estimate("box")
    assert np.hypot(estimate.x_m - array.pose[0], estimate.y_m - array.pose[1]) < 0.005


def test_parcel_rests_after_it_has_arrived(rolling_array) -> None:
    coordinator = steering(GoalPose(0.05, 0.0, 0.1))
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0), noise_m_s=0.002)
    array.run(coordinator, 10.0, lambda: coordinator.finished)
    array.run(coordinator, array.now_s + 0.2)
    rest = array.pose
    array.run(coordinator, array.now_s + 2.0)
    np.testing.assert_allclose(array.pose, rest, atol=2e-4)


def test_setpoints_follow_sync_by_half_a_period(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, FieldProgram(np.linspace(-0.1, 0.1, 36)))
    array = running(rolling_array, coordinator)
    sent = []
    while len(sent) < 60:
        array.now_s = coordinator.wake_s
        sent += [(array.now_s, frame) for frame in coordinator.poll(array.now_s)]
    syncs = [time_s for time_s, frame in sent if frame.can_id == cob.SYNC]
    setpoints = [item for item in sent if 0x200 < item[1].can_id <= 0x212]
    np.testing.assert_allclose(np.diff(syncs), 0.01)
    assert {round((time_s - syncs[0]) % 0.01, 6) for time_s, _ in setpoints} == {0.005}
    last = {frame.can_id: pdo.TARGET_VELOCITY.decode(frame.data) for _, frame in setpoints}
    assert last[0x201] == (-100_000, -94_286)
    assert last[0x212] == (94_286, 100_000)


def test_a_reference_that_no_drive_takes_is_refused_before_it_is_sent(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, FieldProgram(np.full(36, 11.0)))
    array = running(rolling_array, coordinator)
    with pytest.raises(OutOfRangeError, match=r"0x60FF.*11000000"):
        array.run(coordinator, array.now_s + 0.1)


def test_a_cell_that_falls_silent_stops_the_array_and_is_named(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, FieldProgram(np.full(36, 0.05)), policy=STRICT)
    array = running(rolling_array, coordinator)
    dies_s = array.cells[6].dies_s = array.now_s + 0.5
    array.run(coordinator, dies_s + 2.0, lambda: coordinator.stopped)
    assert coordinator.fault == (
        "cell 7 (node 7) has fallen silent: no speeds for 0.1 s; "
        "not confirmed to be off: cell 7 (node 7); cut the motors' power"
    )
    assert array.now_s < dies_s + 0.45
    array.run(coordinator, array.now_s + 0.1)
    off = [cell.states for cell in array.cells if cell.node_id != 7]
    assert off == [[cia402.SWITCH_ON_DISABLED] * 2] * 17


def test_a_cell_that_restarts_stops_the_array(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, still(), policy=STRICT)
    array = running(rolling_array, coordinator)
    array.inject(nmt.heartbeat(5, nmt.INITIALISING))
    array.run(coordinator, array.now_s + 0.2, lambda: coordinator.stopped)
    assert "cell 5 (node 5) is no longer operational" in coordinator.fault


def test_a_cell_whose_node_id_another_node_has_too_stops_the_array_by_that_reason(
    rolling_array,
) -> None:
    coordinator = Coordinator(LAYOUT, still(), policy=STRICT)
    array = running(rolling_array, coordinator)
    array.inject(Frame(cob.EMCY_BASE + 5, b"\x50\x81\x11\x05\0\0\0\0"))
    array.inject(nmt.heartbeat(5, nmt.PRE_OPERATIONAL))
    array.run(coordinator, array.now_s + 0.2, lambda: coordinator.stopped)
    assert coordinator.fault.endswith("; 0x8150: another node has the same node id")
    assert advice_for(coordinator.fault).startswith("Give one of the two nodes another id")


def test_a_drive_that_trips_stops_the_array(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, still(), policy=STRICT)
    array = running(rolling_array, coordinator)
    array.cells[1].states[1] = cia402.FAULT
    array.run(coordinator, array.now_s + 0.2, lambda: coordinator.stopped)
    assert coordinator.fault == (
        "cell 2 (node 2) has disabled its drives: axis 1 operation enabled, axis 2 fault"
    )


def test_stop_ends_in_order_without_a_fault(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, FieldProgram(np.full(36, 0.05)))
    array = running(rolling_array, coordinator)
    coordinator.stop()
    array.run(coordinator, array.now_s + 1.0, lambda: coordinator.stopped)
    assert (coordinator.phase, coordinator.fault) == (Phase.STOPPED, None)
    assert not any(cia402.OPERATION_ENABLED in cell.states for cell in array.cells)


@pytest.mark.parametrize("base", [0x180, 0x280, 0x700])
def test_garbage_of_a_cell_is_counted_and_dropped(rolling_array, base: int) -> None:
    coordinator = Coordinator(LAYOUT, still())
    array = running(rolling_array, coordinator)
    array.inject(Frame(base + 4, b"\xff" * 3))
    array.run(coordinator, array.now_s + 0.3)
    assert coordinator.cells[3].garbage == 1
    assert coordinator.phase == Phase.RUNNING


def test_garbage_of_cells_is_no_report_of_their_sensors(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, still(), parcels=(BOX,))
    array = running(rolling_array, coordinator)
    array.run(coordinator, array.now_s + 0.5)
    assert coordinator.tracker.poses(array.now_s).keys() == {"box"}
    array.lost = lambda frame: frame.can_id & ~0x7F == 0x280 and len(frame.data) > 3
    for _ in range(10):
        for cell in coordinator.cells:
            array.inject(Frame(0x280 + cell.node_id, b"\xff" * 3))
        array.run(coordinator, array.now_s + 0.1)
    assert coordinator.tracker.doubtful == {"box"}


@given(st.lists(st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8)), max_size=40))
def test_no_frame_whatever_raises(frames: list[tuple[int, bytes]]) -> None:
    coordinator = Coordinator(LAYOUT, still(), parcels=(BOX,))
    for number, (can_id, data) in enumerate(frames):
        coordinator.on_frame(Frame(can_id, data), number * 0.004)
        coordinator.poll(number * 0.004)


def test_more_wheels_than_axes_are_refused() -> None:
    layout = Layout(1, 1, wheels=(WheelPlace(0.0), WheelPlace(2.0), WheelPlace(4.0)))
    with pytest.raises(ValueError, match="2 axes on the wire, the layout wants 3"):
        Coordinator(layout, still(layout))


def emergency(code: int, source: int) -> Frame:
    return Frame(0x082, code.to_bytes(2, "little") + bytes((0x11, source, 0, 0, 0, 0)))


def test_emergencies_have_their_words_and_a_cleared_one_is_called_so(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, still())
    array = running(rolling_array, coordinator)
    before = len(coordinator.events)
    for code, source in ((0x8250, 1), (0x8250, 1), (0x8130, 3), (0, 1)):
        coordinator.on_frame(emergency(code, source), array.now_s)
    assert [text for _, text in coordinator.events[before:]] == [
        "cell 2 (node 2) sends emergency 0x8250: no setpoint for 50 ms (axis 1)",
        "cell 2 (node 2) sends emergency 0x8130: heartbeat of the host lost",
        "cell 2 (node 2) clears emergency 0x8250: no setpoint for 50 ms (axis 1)",
    ]


def test_a_drive_that_trips_is_named_with_its_reason(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, still())
    array = running(rolling_array, coordinator)
    array.cells[1].states[1] = cia402.FAULT
    coordinator.on_frame(emergency(0x7121, 2), array.now_s)
    array.run(coordinator, array.now_s + 0.2, lambda: coordinator.stopped)
    assert coordinator.fault == (
        "cell 2 (node 2) has disabled its drives: axis 1 operation enabled, axis 2 fault; "
        "0x7121: wheel stands under voltage: stalled (axis 2)"
    )


def test_another_host_that_begins_at_the_same_time_stops_both(rolling_array) -> None:
    """Each has listened before, and nobody spoke yet."""
    coordinator = Coordinator(LAYOUT, FieldProgram(np.full(36, 0.05)))
    array = running(rolling_array, coordinator)
    array.inject(nmt.heartbeat(127, nmt.OPERATIONAL))
    array.run(coordinator, array.now_s + 0.5, lambda: coordinator.stopped)
    assert coordinator.phase == Phase.FAILED
    assert "another host runs on this bus (a heartbeat of node 127)" in coordinator.fault


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0x306, pdo.CONTROLWORD.encode((cia402.ENABLE_OPERATION,) * 2)),
        Frame(0x206, pdo.TARGET_VELOCITY.encode((200_000, 0))),
        Frame(0x606, sdo.write_request(0x6040, 0, b"\x0f\x00")),
        Frame(0x606, sdo.write_request(0x68FF, 0, b"\x00\x00\x00\x00")),
    ],
)
def test_another_program_that_commands_a_drive_ends_the_run(rolling_array, frame: Frame) -> None:
    coordinator = Coordinator(LAYOUT, FieldProgram(np.full(36, 0.05)))
    array = running(rolling_array, coordinator)
    array.inject(Frame(0x606, sdo.read_request(0x6040, 0)))
    array.inject(Frame(0x606, sdo.write_request(0x3007, 0, b"\x00\x00")))
    array.run(coordinator, array.now_s + 0.2)
    assert coordinator.phase == Phase.RUNNING
    array.inject(frame)
    array.run(coordinator, array.now_s + 0.5, lambda: coordinator.stopped)
    assert coordinator.fault == (
        "another program commands drives on this bus (controlwords or setpoints): cell 6 (node 6)"
    )
    assert not any(cia402.OPERATION_ENABLED in cell.states for cell in array.cells)


@pytest.mark.parametrize("command", [nmt.RESET_NODE, nmt.RESET_COMMUNICATION, nmt.STOP])
def test_another_program_that_switches_one_cell_off_ends_the_run(rolling_array, command) -> None:
    coordinator = Coordinator(LAYOUT, still())
    array = running(rolling_array, coordinator)
    array.inject(nmt.command(nmt.START, 6))
    array.run(coordinator, array.now_s + 0.2)
    assert coordinator.phase == Phase.RUNNING
    array.inject(nmt.command(command, 6))
    array.run(coordinator, array.now_s + 0.5, lambda: coordinator.stopped)
    assert "another program has switched cells off" in coordinator.fault


def test_a_cell_that_is_found_stopped_ends_the_run_though_no_command_was_heard(
    rolling_array,
) -> None:
    coordinator = Coordinator(LAYOUT, still())
    array = running(rolling_array, coordinator)
    array.inject(Frame(cob.HEARTBEAT_BASE + 6, bytes((nmt.STOPPED,))))
    array.run(coordinator, array.now_s + 0.5, lambda: coordinator.stopped)
    assert "another program has switched cells off" in coordinator.fault


def test_a_journal_of_weeks_keeps_the_latest_events_and_counts_all():
    journal = EventJournal()
    for number in range(3 * EVENTS_KEPT):
        journal.warn(float(number), "it is late")
    assert EVENTS_KEPT <= len(journal.events) <= 2 * EVENTS_KEPT
    assert len(journal.troubles) == EVENTS_KEPT
    assert journal.events[-1][0] == journal.troubles[-1][0] == 3 * EVENTS_KEPT - 1
    latest, count = journal.since(3 * EVENTS_KEPT - 2)
    assert ([time_s for time_s, _ in latest], count) == (
        [3 * EVENTS_KEPT - 2, 3 * EVENTS_KEPT - 1],
        3 * EVENTS_KEPT,
    )
    assert journal.since(0)[0] == journal.events
    assert journal.since(count) == ([], count)
