import io
from collections.abc import Callable

import canopen
import pytest
from canopen.objectdictionary import ODRecord, ODVariable
from rich.console import Console
from tests.virtual_array import StandingArray, virtual_time

from mdms_host.clock import MonotonicClock
from mdms_host.commissioning.network import Commissioning, RefusedError, SilentError
from mdms_host.commissioning.status import scan_bus, scan_table
from mdms_protocol import pdo
from mdms_protocol.codecs import cob, nmt, sdo
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.dictionary import DEVICE_NAME, PRODUCT_CODE
from mdms_protocol.entry import OutOfRangeError
from mdms_sim.nodes.python_bank import PythonBank


def test_all_cells_are_found_with_their_identities(standing_cells) -> None:
    nodes = scan_bus(None, MonotonicClock())
    assert [node.node_id for node in nodes] == [1, 2, 3]
    assert all(node.is_cell and node.problem is None for node in nodes)
    assert {node.state for node in nodes} == {"pre-operational"}
    assert (nodes[0].identity.name, nodes[0].identity.product_code) == (DEVICE_NAME, PRODUCT_CODE)
    assert scan_table({"can0": nodes}).row_count == 3


def test_nothing_is_found_on_an_empty_bus() -> None:
    with virtual_time(StandingArray(None, 0)):
        assert scan_bus(None, MonotonicClock()) == []


def test_a_cell_whose_pdos_a_gateway_repeats_is_no_node_of_this_bus(standing_cells) -> None:
    array = standing_cells.array
    send = array.attach(lambda _frame, _now_s: None)
    speeds = Frame(pdo.ACTUAL_VELOCITY.can_id(cob.CELL_NODE_MAX), bytes(8))
    array.hand = lambda: send(speeds)
    assert [node.node_id for node in scan_bus(None, MonotonicClock())] == [1, 2, 3]


def test_a_stranger_is_found_and_told_from_cells() -> None:
    nobody = StandingArray(None, 0)
    network = canopen.Network()
    send = nobody.attach(
        lambda frame, now_s: network.notify(frame.can_id, bytearray(frame.data), now_s)
    )
    network.send_message = lambda can_id, data, **_: send(Frame(can_id, bytes(data)))
    network.create_node(9, canopen.ObjectDictionary())
    with virtual_time(nobody):
        (stranger,) = scan_bus(None, MonotonicClock())
    assert (stranger.node_id, stranger.is_cell, stranger.state) == (9, False, None)
    assert stranger.problem == "not an MDMS cell"


def test_name_of_a_stranger_controls_no_terminal() -> None:
    nobody = StandingArray(None, 0)
    network = canopen.Network()
    send = nobody.attach(
        lambda frame, now_s: network.notify(frame.can_id, bytearray(frame.data), now_s)
    )
    network.send_message = lambda can_id, data, **_: send(Frame(can_id, bytes(data)))
    objects = canopen.ObjectDictionary()
    for index in (0x1008, 0x100A):
        objects.add_object(ODVariable(f"text {index:X}", index))
    objects.add_object(record := ODRecord("identity", 0x1018))
    for sub in range(1, 5):
        record.add_member(ODVariable(f"number {sub}", 0x1018, sub))
    node = network.create_node(9, objects)
    texts = {0x1008: b"\x1b[2J[/red]\x07", 0x100A: b"\x9b31m"}
    node.add_read_callback(lambda index, **_: texts.get(index, bytes(4)))
    with virtual_time(nobody):
        (stranger,) = scan_bus(None, MonotonicClock())
    assert stranger.identity.name == "?[2J[/red]?"
    shown = Console(file=io.StringIO(), width=120)
    shown.print(scan_table({"can0": [stranger]}))
    assert "?[2J[/red]?" in shown.file.getvalue()
    assert "\x9b" not in stranger.identity.software


def _answered_by(answer: Callable[[bytes], bytes], *besides: Frame) -> StandingArray:
    """Two cells, and a node 9 that gives such answers to SDO requests, behind other frames."""
    array = StandingArray(PythonBank((1, 2)), 2)

    def deliver(frame: Frame, _now_s: float) -> None:
        if frame.can_id == cob.SDO_REQUEST_BASE + 9:
            for each in (*besides, Frame(cob.SDO_RESPONSE_BASE + 9, answer(frame.data))):
                send(each)

    send = array.attach(deliver)
    return array


@pytest.mark.parametrize("size", range(8))
@pytest.mark.parametrize("command", [0x43, sdo.ABORT])
def test_answers_that_are_cut_off_are_none(size: int, command: int) -> None:
    array = _answered_by(lambda request: (bytes((command,)) + request[1:])[:size])
    with virtual_time(array):
        *cells, stranger = scan_bus(None, MonotonicClock())
    assert [(node.node_id, node.problem) for node in cells] == [(1, None), (2, None)]
    assert (stranger.node_id, stranger.identity) == (9, None)
    assert "No SDO response received" in stranger.problem


def test_short_emergencies_and_heartbeats_harm_no_answer() -> None:
    short = (Frame(cob.EMCY_BASE + 9, b"\x50\x82"), Frame(cob.HEARTBEAT_BASE + 9, b""))
    array = _answered_by(lambda request: b"\x43" + request[1:4] + b"\1\0\0\0", *short)
    with virtual_time(array), Commissioning(None, MonotonicClock()) as bus:
        assert [bus.read(9, 0x1000) for _ in range(3)] == [1, 1, 1]


def test_a_text_without_an_end_is_given_up() -> None:
    def answer(request: bytes) -> bytes:
        if request[0] & sdo.SPECIFIER == sdo.UPLOAD_SEGMENT:
            return bytes((request[0] & sdo.TOGGLE,)) + b"endless"
        return b"\x40" + request[1:4] + bytes(4)

    with virtual_time(_answered_by(answer)):
        stranger = scan_bus(None, MonotonicClock())[-1]
    assert stranger.problem.endswith("its answer goes on after 1024 bytes")


def test_a_negative_value_keeps_its_sign(commissioning) -> None:
    commissioning.write(1, 0x60FF, 0, -123_456)
    assert commissioning.read(1, 0x60FF) == -123_456


def test_a_refusal_names_node_object_and_reason(commissioning) -> None:
    with pytest.raises(RefusedError, match=r"node 1, 0x1000:0 Device type: refused, .*0x0601"):
        commissioning.write(1, 0x1000, 0, 1)


@pytest.mark.parametrize("code", [sdo.UNKNOWN_COMMAND, sdo.TOGGLE_NOT_ALTERNATED])
def test_a_text_that_another_program_breaks_off_is_asked_for_again(code: int) -> None:
    """A request of the other one ends a transfer of several frames: a server has one at a time."""
    begins = []

    def answer(request: bytes) -> bytes:
        if request[0] & sdo.SPECIFIER != sdo.UPLOAD_SEGMENT:
            begins.append(request)
            return b"\x41" + request[1:4] + b"\4\0\0\0"
        if len(begins) < 3:
            return bytes((sdo.ABORT, 0, 0, 0)) + code.to_bytes(4, "little")
        return b"\x07name" + bytes(3)

    with virtual_time(_answered_by(answer)), Commissioning(None, MonotonicClock()) as bus:
        assert bus.read_text(9, 0x1008) == "name"
    assert len(begins) == 3


def test_a_value_out_of_range_is_not_even_sent(commissioning) -> None:
    with pytest.raises(OutOfRangeError, match="0x2000"):
        commissioning.write(1, 0x2000, 0, 100_001)
    with pytest.raises(KeyError, match="no object 0x5FFF:0"):
        commissioning.read(1, 0x5FFF)


def test_answers_right_behind_a_sync_are_all_received() -> None:
    """canopen-python/canopen#623: nothing is asked twice, and no answer is missed."""
    array = StandingArray(PythonBank((1, 2)), 2)
    producer = array.attach(lambda _frame, _now_s: None)
    requests = []

    def sync_behind(frame: Frame) -> None:
        """Behind each request, and so before its answer, there is a SYNC."""
        if frame.can_id == cob.SDO_REQUEST_BASE + 2:
            requests.append(frame)
            producer(Frame(cob.SYNC, b""))

    with virtual_time(array) as time, Commissioning(None, MonotonicClock()) as bus:
        time.before_send = sync_behind
        assert [bus.read(2, 0x2000) for _ in range(20)] == [13_000] * 20
    assert len(requests) == 20


def test_a_node_that_is_not_there_is_silent(commissioning) -> None:
    with pytest.raises(SilentError, match="node 77"):
        commissioning.read(77, 0x2000)


def test_settings_are_stored_once_no_wheel_brakes(commissioning, standing_cells, monkeypatch):
    parameters = standing_cells.array.bank._cells[0]._parameters
    ends_s = standing_cells.now_s() + 1.0
    monkeypatch.setattr(parameters, "_driving", lambda: standing_cells.now_s() < ends_s)
    commissioning.store(1)
    assert ends_s <= standing_cells.now_s() < ends_s + 0.1
    monkeypatch.setattr(parameters, "_driving", lambda: True)
    with pytest.raises(RefusedError):
        commissioning.store(1)
    assert standing_cells.now_s() < ends_s + 3.0


def test_nmt_commands_reach_one_node(commissioning) -> None:
    commissioning.command(nmt.START, 2)
    # Its next heartbeat says so.
    MonotonicClock().sleep(0.2)
    assert commissioning.states[2] == nmt.OPERATIONAL
    assert commissioning.states.get(1, nmt.PRE_OPERATIONAL) == nmt.PRE_OPERATIONAL


def test_a_frame_at_the_first_moment_is_heard(monkeypatch) -> None:
    class EagerLink:
        """Delivers before its maker has it, as a reader may."""

        def __init__(self, bus, clock, deliver) -> None:
            deliver(nmt.heartbeat(5, nmt.OPERATIONAL), clock.now_s())

    monkeypatch.setattr("mdms_host.commissioning.network.Link", EagerLink)
    assert Commissioning(None, MonotonicClock()).states == {5: nmt.OPERATIONAL}
