"""How cells are brought up: identities, settings, and the time at which drives come on."""

import numpy as np
import pytest
from tests.host.coordination.arrays import BOTTOM, LAYOUT, running, still

from mdms_cell.canopen.objects import Objects
from mdms_host.can_link.sdo_client import Setting
from mdms_host.coordination.bring_up import ExpectedCells
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.run_state import Phase, Timing
from mdms_host.layout import Layout
from mdms_host.motion.program import FieldProgram
from mdms_protocol import record, signature
from mdms_protocol.codecs import cia402
from mdms_protocol.codecs.frame import Frame

#: A cell's answer to the question for its revision: that of our object table.
REVISION = bytes.fromhex("4318100300000100")
#: And for its serial number.
SERIAL = bytes.fromhex("431810041A000000")


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
    """The answer of a cell when its second TPDO is repeated every 200 ms, and all else is usual."""
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
    """The controlwords while both axes of cell 1 report these states one after another."""
    sent = []
    for step, state in enumerate(statuswords):
        word = state | cia402.VOLTAGE_ENABLED
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
        coordinator.on_frame(Frame(0x280 + node_id, bytes((0x31, 0, 0x31, 0, 0))), 0.021)
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


@pytest.mark.parametrize(
    ("emergency", "named"),
    [
        (None, ""),
        ("1023020100000000", "; 0x2310: over-current, or the bridge has shut off (axis 1)"),
    ],
)
def test_a_drive_that_cannot_be_enabled_is_named_with_its_state(
    rolling_array, emergency, named
) -> None:
    coordinator = Coordinator(LAYOUT, still(), timing=Timing(phase_limit_s=1.0))
    array = rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))
    array.cells[8].stuck = True
    if emergency is not None:
        array.run(coordinator, 3.0, lambda: coordinator.phase == Phase.ENABLING)
        coordinator.on_frame(Frame(0x089, bytes.fromhex(emergency)), array.now_s)
    array.run(coordinator, 3.0, lambda: coordinator.stopped)
    assert coordinator.fault == (
        "drives not enabled within 1 s: cell 9 (node 9) "
        f"(axis 1 switch on disabled, axis 2 switch on disabled{named})"
    )


def test_settings_are_written_to_every_cell(rolling_array) -> None:
    gain = Setting(0x2000, 0, 8_000)
    expected = ExpectedCells((gain, Setting(0x3000, 0, 80)))
    coordinator = Coordinator(LAYOUT, still(), expected=expected)
    array = running(rolling_array, coordinator)
    expected = [bytes.fromhex("23002000401f0000"), bytes.fromhex("2b00300050000000")]
    assert [cell.writes[-2:] for cell in array.cells] == [expected] * 18


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


def test_a_setting_of_one_cell_is_written_to_it_alone(rolling_array) -> None:
    reversed_ = Setting(0x607E, 0, 0x40)
    expected = ExpectedCells(own_settings={5: (reversed_,)})
    coordinator = Coordinator(LAYOUT, still(), expected=expected)
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
        cell.objects.tie(0x1018, 3, read=lambda revision=revision: revision)
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
    array.cells[0].objects.tie(0x1018, 3, read=lambda: 0x00010007)
    array.run(coordinator, 1.0, lambda: coordinator.phase == Phase.RUNNING)
    assert coordinator.phase == Phase.RUNNING


def test_a_cell_without_an_identity_is_a_fault() -> None:
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


def test_a_cell_whose_answers_get_lost_for_half_a_second_comes_up_all_the_same() -> None:
    layout = Layout(1, 1)
    coordinator = Coordinator(layout, still(layout))
    for cycle in range(50):
        coordinator.on_frame(Frame(0x701, b"\x7f"), 0.01 * cycle)
        coordinator.poll(0.01 * cycle)
    assert coordinator.fault is None
    for answer in (REVISION, SERIAL):
        coordinator.on_frame(Frame(0x581, answer), 0.5)
        coordinator.poll(0.5)
    coordinator.poll(0.5)
    assert coordinator.phase == Phase.CONFIGURING
