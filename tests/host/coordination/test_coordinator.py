import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.host.motion.driving import traction_of

from mdms_cell.canopen.objects import Objects, key
from mdms_host.can_link.sdo_client import Setting
from mdms_host.coordination.care.policy import Policy
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.phase import Phase
from mdms_host.coordination.schedule import Timing
from mdms_host.estimation.outlines.rectangle import Rectangle
from mdms_host.estimation.tracker import Parcel
from mdms_host.layout import Layout, WheelPlace
from mdms_host.motion.by_cells.program import CellsProgram
from mdms_host.motion.goal import Goal
from mdms_host.motion.program import FieldProgram, GoalProgram
from mdms_host.places import all_values
from mdms_protocol import indices, pdo, record, signature
from mdms_protocol.codecs import cia402, cob, nmt
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.entry import OutOfRangeError
from mdms_protocol.neighbours import messages

LAYOUT = Layout(6, 3, wheels=(WheelPlace(0.0, (0.0, 0.03)), WheelPlace(np.pi / 2, (0.03, 0.0))))
BOX = Parcel("box", 0.36, 0.30)
BOTTOM = Rectangle(0.36, 0.30)
#: A cell's answer to the question for its revision: that of our object table.
REVISION = bytes.fromhex("4318100300000100")
#: And for its serial number.
SERIAL = bytes.fromhex("431810041A000000")


#: No trouble passes.
STRICT = Policy(pauses=0)


def still(layout: Layout = LAYOUT) -> FieldProgram:
    return FieldProgram(np.zeros(len(layout.wheel_cells)))


def steering(goal: Goal) -> Coordinator:
    return Coordinator(
        LAYOUT, GoalProgram(traction_of(LAYOUT), (BOX,), {"box": goal}), parcels=(BOX,)
    )


def running(rolling_array, coordinator: Coordinator, layout: Layout = LAYOUT):
    array = rolling_array(layout, BOTTOM, (0.0, 0.0, 0.0))
    array.run(coordinator, 1.0, lambda: coordinator.phase == Phase.RUNNING)
    assert coordinator.phase == Phase.RUNNING
    return array


@pytest.mark.parametrize(
    ("start", "goal", "seed"),
    [
        ((-0.10, 0.0, 0.0), (0.10, 0.0, np.pi / 6), 1),
        ((0.13, 0.02, 0.2), (-0.10, -0.01, -0.4), 2),
        ((-0.05, -0.02, -0.3), (0.0, 0.0, 0.5), 3),
    ],
)
def test_parcel_reaches_its_goal(rolling_array, start, goal, seed: int) -> None:
    coordinator = steering(Goal(*goal))
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
    coordinator = steering(Goal(0.05, 0.0, 0.1))
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0), noise_m_s=0.002)
    array.run(coordinator, 10.0, lambda: coordinator.finished)
    array.run(coordinator, array.now_s + 0.2)
    rest = array.pose
    array.run(coordinator, array.now_s + 2.0)
    np.testing.assert_allclose(array.pose, rest, atol=2e-4)


def test_bring_up_goes_through_its_phases_in_order(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, still())
    running(rolling_array, coordinator)
    told = [text for _, text in coordinator.events]
    assert told == [
        Phase.WAITING,
        Phase.IDENTIFYING,
        Phase.CONFIGURING,
        Phase.STARTING,
        Phase.ENABLING,
        Phase.RUNNING,
    ]


def signature_of_a_cell(node_id: int = 1) -> bytes:
    """What a cell answers when its second TPDO is repeated every 200 ms, and all else is usual."""
    objects = Objects()
    objects.reset(node_id, record.FROM_NODE)
    objects.put(0x1801, 5, 200)
    return signature.of(objects.data).to_bytes(4, "little")


@pytest.fixture
def started() -> Coordinator:
    """A coordinator of one cell, which has been heard and set up, and is to be started."""
    layout = Layout(1, 1)
    coordinator = Coordinator(layout, still(layout))
    coordinator.on_frame(Frame(0x701, b"\x7f"), 0.0)
    for _ in range(2):
        coordinator.poll(0.0)
    for answer in (REVISION, SERIAL):
        coordinator.on_frame(Frame(0x581, answer), 0.0)
        for _ in range(2):
            coordinator.poll(0.0)
    coordinator.on_frame(Frame(0x581, bytes.fromhex("6001180500000000")), 0.01)
    coordinator.poll(0.01)
    coordinator.on_frame(Frame(0x581, b"\x43\x05\x30\x00" + signature_of_a_cell()), 0.01)
    assert Frame(0x000, b"\x01\x01") in coordinator.poll(0.01)
    coordinator.on_frame(Frame(0x701, b"\x05"), 0.02)
    return coordinator


def controlwords(coordinator: Coordinator, *statuswords: int) -> list[bytes]:
    """What is commanded while both axes of cell 1 tell these statuswords one after another."""
    sent = []
    for step, word in enumerate(statuswords):
        now_s = 0.02 + 0.002 * step
        coordinator.on_frame(Frame(0x281, bytes((word, 0, word, 0, 0))), now_s)
        for _ in range(3):
            frames = coordinator.poll(now_s)
            sent += [frame.data for frame in frames if frame.can_id == 0x301]
    return sent


def test_drives_are_enabled_step_by_step(started: Coordinator) -> None:
    assert controlwords(started, 0x40, 0x21, 0x23, 0x27) == [
        b"\x06\x00\x06\x00",
        b"\x07\x00\x07\x00",
        b"\x0f\x00\x0f\x00",
    ]
    assert started.phase == Phase.RUNNING


def test_a_cell_that_answers_gets_on_and_the_others_are_not_told_again() -> None:
    layout = Layout(3, 1)
    coordinator = Coordinator(layout, still(layout))
    coordinator.poll(0.0)
    for node_id in layout.node_ids:
        coordinator.on_frame(Frame(0x700 + node_id, b"\x7f"), 0.0)
    assert {0x601, 0x602, 0x603} <= {frame.can_id for frame in coordinator.poll(0.0)}
    for answer in (REVISION, SERIAL):
        coordinator.poll(0.0)
        for node_id in layout.node_ids:
            coordinator.on_frame(Frame(0x580 + node_id, answer), 0.0)
    asked = {frame.can_id for frame in coordinator.poll(0.0)}
    assert {0x601, 0x602, 0x603} <= asked
    for node_id in layout.node_ids:
        coordinator.on_frame(Frame(0x580 + node_id, bytes.fromhex("6001180500000000")), 0.01)
        coordinator.poll(0.01)
        answer = b"\x43\x05\x30\x00" + signature_of_a_cell(node_id)
        coordinator.on_frame(Frame(0x580 + node_id, answer), 0.01)
        coordinator.poll(0.01)
    for node_id in layout.node_ids:
        coordinator.on_frame(Frame(0x700 + node_id, b"\x05"), 0.02)
    assert coordinator.poll(0.02)
    assert coordinator.phase == Phase.ENABLING
    for node_id in layout.node_ids:
        coordinator.on_frame(Frame(0x280 + node_id, bytes((0x21, 0, 0x21, 0, 0))), 0.021)
        assert coordinator.wake_s == 0.021
        assert coordinator.poll(0.021) == [Frame(0x300 + node_id, b"\x07\x00\x07\x00")]
    assert len([each for each in coordinator.poll(0.071) if each.can_id & 0x780 == 0x300]) == 3


def test_a_drive_in_fault_is_reset_by_an_edge(started: Coordinator) -> None:
    assert controlwords(started, 0x08) == [b"\x00\x00\x00\x00", b"\x80\x00\x80\x00"]


def test_a_cell_left_running_is_taken_back_first() -> None:
    layout = Layout(1, 1)
    coordinator = Coordinator(layout, still(layout))
    coordinator.poll(0.0)
    coordinator.on_frame(Frame(0x701, b"\x05"), 0.01)
    frames = [frame for now_s in (0.05, 0.1) for frame in coordinator.poll(now_s)]
    assert Frame(0x000, b"\x80\x01") in frames
    assert coordinator.phase == Phase.WAITING
    coordinator.on_frame(Frame(0x701, b"\x7f"), 0.11)
    coordinator.poll(0.11)
    assert coordinator.phase == Phase.IDENTIFYING


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
    assert coordinator.fault == "cell 7 (node 7) has fallen silent: no speeds for 0.1 s"
    assert array.now_s < dies_s + 0.45
    array.run(coordinator, array.now_s + 0.1)
    off = [cell.states for cell in array.cells if cell.node_id != 7]
    assert off == [[cia402.SWITCH_ON_DISABLED] * 2] * 17


def test_a_cell_that_is_missing_is_named_after_the_time_limit(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, still(), timing=Timing(phase_limit_s=2.0))
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    array.cells[3].boots_s = array.cells[11].boots_s = np.inf
    array.run(coordinator, 3.0, lambda: coordinator.stopped)
    assert coordinator.fault == "not heard within 2 s: cell 4 (node 4), cell 12 (node 12)"
    assert array.now_s == pytest.approx(2.0, abs=0.15)


def test_an_empty_bus_is_told_from_a_missing_cell() -> None:
    coordinator = Coordinator(LAYOUT, still(), timing=Timing(phase_limit_s=1.0))
    while not coordinator.stopped:
        coordinator.poll(coordinator.wake_s)
    assert coordinator.fault.startswith("no cell was heard within 1 s")


def test_a_drive_that_cannot_be_enabled_is_named_with_its_state(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, still(), timing=Timing(phase_limit_s=1.0))
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    array.cells[8].stuck = True
    array.run(coordinator, 3.0, lambda: coordinator.stopped)
    assert coordinator.fault == (
        "drives not enabled within 1 s: cell 9 (node 9) "
        "(axis 1 switch on disabled, axis 2 switch on disabled)"
    )


def test_a_cell_that_restarts_stops_the_array(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, still(), policy=STRICT)
    array = running(rolling_array, coordinator)
    array.inject(nmt.heartbeat(5, nmt.INITIALISING))
    array.run(coordinator, array.now_s + 0.2, lambda: coordinator.stopped)
    assert "cell 5 (node 5) is no longer operational" in coordinator.fault


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


def test_settings_are_written_to_every_cell(rolling_array) -> None:
    gain = Setting(0x2000, 0, 8_000)
    coordinator = Coordinator(LAYOUT, still(), settings=(gain, Setting(0x3000, 0, 80)))
    array = running(rolling_array, coordinator)
    expected = [bytes.fromhex("23002000401f0000"), bytes.fromhex("2b00300050000000")]
    assert [cell.writes[-2:] for cell in array.cells] == [expected] * 18


@pytest.mark.parametrize("base", [0x180, 0x280, 0x700])
def test_garbage_of_a_cell_is_counted_and_dropped(rolling_array, base: int) -> None:
    coordinator = Coordinator(LAYOUT, still())
    array = running(rolling_array, coordinator)
    array.inject(Frame(base + 4, b"\xff" * 3))
    array.run(coordinator, array.now_s + 0.3)
    assert coordinator.cells[3].garbage == 1
    assert coordinator.phase == Phase.RUNNING


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


def test_a_cell_with_another_stored_setting_is_refused_by_name(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, still())
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    array.cells[4].objects.put(0x607E, 0, 0x40)
    array.cells[4].objects.put(0x3000, 0, 400)
    array.run(coordinator, 3.0, lambda: coordinator.stopped)
    assert coordinator.fault == (
        "cell 5 (node 5) is not set up as this run expects: Setpoint timeout (0x3000:0) is 400, "
        "not 50, Axis 1 polarity (0x607E:0) is 64, not 0"
    )
    assert all(cell.states == [cia402.SWITCH_ON_DISABLED] * 2 for cell in array.cells)


def test_what_one_cell_needs_otherwise_is_written_to_it_alone(rolling_array) -> None:
    reversed_ = Setting(0x607E, 0, 0x40)
    coordinator = Coordinator(LAYOUT, still(), own_settings={5: (reversed_,)})
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    array.run(coordinator, 3.0, lambda: coordinator.phase == Phase.RUNNING)
    assert coordinator.phase == Phase.RUNNING
    polarities = [cell.objects.number(0x607E) for cell in array.cells]
    assert polarities == [0x40 if cell.node_id == 5 else 0 for cell in array.cells]


def test_cells_of_another_protocol_are_named_and_nothing_is_written_to_any_cell(
    rolling_array,
) -> None:
    coordinator = Coordinator(LAYOUT, FieldProgram(np.full(36, 0.05)))
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    for cell, revision in ((array.cells[2], 0x00020001), (array.cells[16], 0x00020000)):
        cell.objects.reads[key(0x1018, 3)] = lambda revision=revision: revision
    array.run(coordinator, 2.0, lambda: coordinator.stopped)
    assert coordinator.fault == (
        "cell 3 (node 3), cell 17 (node 17): each speaks revision 2 of the protocol, this host 1; "
        "flash the same version: mdms flash"
    )
    assert coordinator.phase == Phase.FAILED
    assert not any(cell.writes for cell in array.cells)


def test_a_later_revision_of_the_same_protocol_is_taken(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, still())
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    array.cells[0].objects.reads[key(0x1018, 3)] = lambda: 0x00010007
    array.run(coordinator, 1.0, lambda: coordinator.phase == Phase.RUNNING)
    assert coordinator.phase == Phase.RUNNING


def test_a_cell_that_does_not_say_who_it_is_is_a_fault() -> None:
    layout = Layout(1, 1)
    coordinator = Coordinator(layout, still(layout))
    coordinator.on_frame(Frame(0x701, b"\x7f"), 0.0)
    for _ in range(2):
        coordinator.poll(0.0)
    coordinator.on_frame(Frame(0x581, bytes.fromhex("8018100300000206")), 0.0)
    coordinator.poll(0.0)
    assert coordinator.fault == (
        "cell 1 (node 1) cannot be identified: it refuses a read of 0x1018:3 "
        "(abort code 0x06020000)"
    )


def emergency(code: int, source: int) -> Frame:
    return Frame(0x082, code.to_bytes(2, "little") + bytes((0x11, source, 0, 0, 0, 0)))


def test_emergencies_have_their_words_and_what_is_cleared_is_called_so(rolling_array) -> None:
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


def tell_place(array, row: int) -> None:
    """All cells believe to stand in this row, with node 9 in the east."""
    for cell in array.cells:
        cell.objects.put(indices.PLACE, 1, 1)
        cell.objects.put(indices.PLACE, 2, row)
        cell.objects.put(indices.NEIGHBOURS, 1, 9)


def test_place_that_a_cell_was_told_does_not_matter_where_the_host_steers(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, still())
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    tell_place(array, row=7)
    array.run(coordinator, 3.0, lambda: coordinator.phase == Phase.RUNNING)
    assert coordinator.phase == Phase.RUNNING
    assert {cell.objects.number(indices.PLACE, 2) for cell in array.cells} == {7}
    assert {cell.objects.number(indices.CONTROL) for cell in array.cells} == {0}


def test_right_places_cost_no_reading_of_all_settings(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, still())
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    for number, cell in enumerate(array.cells, 1):
        for place, value in all_values(LAYOUT, number).items():
            cell.objects.put(*place, value)
    array.run(coordinator, 3.0, lambda: coordinator.phase == Phase.RUNNING)
    assert coordinator.phase == Phase.RUNNING
    assert all(len(cell.reads) < 10 for cell in array.cells)


def test_cells_that_steer_are_told_their_places_whatever_they_had(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, CellsProgram(LAYOUT, (), {}))
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    tell_place(array, row=7)
    array.run(coordinator, 3.0, lambda: coordinator.phase == Phase.RUNNING)
    assert coordinator.phase == Phase.RUNNING
    for number, cell in enumerate(array.cells, 1):
        for place, value in all_values(LAYOUT, number).items():
            assert cell.objects.number(*place) == value
        assert cell.objects.number(indices.CONTROL) == 1
        written = [int.from_bytes(data[1:3], "little") for data in cell.writes]
        assert written[-1] == indices.CONTROL


def test_cell_that_was_left_to_steer_by_itself_is_made_to_obey(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, still())
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    left = array.cells[2].objects
    left.put(indices.CONTROL, 0, 1)
    left.put(indices.LEASE, 3, 1)
    left.put(indices.CONSUMER_TIMES, 1, 127 << 16 | 75)
    array.run(coordinator, 3.0, lambda: coordinator.phase == Phase.RUNNING)
    assert coordinator.phase == Phase.RUNNING
    for place in ((indices.CONTROL, 0), (indices.LEASE, 3), (indices.CONSUMER_TIMES, 1)):
        assert left.number(*place) == 0


def test_settings_of_a_run_that_cells_steer_are_taken_back_at_its_end(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, CellsProgram(LAYOUT, (), {}))
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    array.run(coordinator, 3.0, lambda: coordinator.phase == Phase.RUNNING)
    coordinator.stop()
    array.run(coordinator, array.now_s + 1.0, lambda: coordinator.stopped)
    assert coordinator.stopped
    for cell in array.cells:
        for place in ((indices.CONTROL, 0), (indices.LEASE, 3), (indices.CONSUMER_TIMES, 1)):
            assert cell.objects.number(*place) == 0


def test_programs_end_behind_the_quick_stop(rolling_array) -> None:
    box = Parcel("box", 0.36, 0.30)
    coordinator = Coordinator(LAYOUT, CellsProgram(LAYOUT, (box,), {"box": Goal(0.1, 0.0)}))
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    array.run(coordinator, 3.0, lambda: coordinator.phase == Phase.RUNNING)
    coordinator.stop()
    frames = coordinator.poll(array.now_s)
    end = frames.index(Frame(cob.PROGRAM, messages.encode_page(messages.End(1, 1))))
    stops = [place for place, frame in enumerate(frames) if is_quick_stop(frame)]
    assert len(stops) == LAYOUT.cells
    assert max(stops) < end


def is_quick_stop(frame: Frame) -> bool:
    words = (cia402.QUICK_STOP,) * len(pdo.CONTROLWORD.entries)
    return frame.data == pdo.CONTROLWORD.encode(words)


def test_host_sends_heartbeats_often_enough_for_cells_that_steer(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, CellsProgram(LAYOUT, (), {}))
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    array.run(coordinator, 3.0, lambda: coordinator.phase == Phase.RUNNING)
    sent = [frame for step in range(300) for frame in coordinator.poll(array.now_s + 0.001 * step)]
    assert sum(frame.can_id == cob.HEARTBEAT_BASE + 127 for frame in sent) == 12
    limits = {cell.objects.number(indices.CONSUMER_TIMES, 1) for cell in array.cells}
    assert limits == {127 << 16 | 75}


def test_cells_that_steer_are_left_to_enable_their_drives(rolling_array) -> None:
    coordinator = Coordinator(LAYOUT, CellsProgram(LAYOUT, (), {}))
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    array.run(coordinator, 3.0, lambda: coordinator.phase == Phase.RUNNING)
    array.run(coordinator, array.now_s + 0.5)
    assert coordinator.fault is None
    assert all(cell.states == [cia402.SWITCHED_ON] * 2 for cell in array.cells)
