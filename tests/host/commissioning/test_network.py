import threading

import can
import canopen
import pytest

from mdms_host.clock import MonotonicClock
from mdms_host.commissioning.network import Commissioning, RefusedError, SilentError
from mdms_host.commissioning.scan import scan_bus, scan_table
from mdms_protocol import cob, nmt
from mdms_protocol.dictionary import DEVICE_NAME, PRODUCT_CODE
from mdms_protocol.entry import OutOfRangeError


def test_all_cells_are_found_and_say_who_they_are(served_cells) -> None:
    nodes = scan_bus(served_cells.open(), MonotonicClock())
    assert [node.node_id for node in nodes] == [1, 2, 3]
    assert all(node.is_cell and node.problem is None for node in nodes)
    assert {node.state for node in nodes} == {"pre-operational"}
    assert (nodes[0].identity.name, nodes[0].identity.product_code) == (DEVICE_NAME, PRODUCT_CODE)
    assert scan_table(nodes).row_count == 3


def test_nothing_is_found_on_an_empty_bus(request) -> None:
    assert scan_bus(can.Bus(request.node.nodeid, interface="virtual"), MonotonicClock()) == []


def test_a_stranger_is_found_and_told_from_cells(request) -> None:
    channel = request.node.nodeid
    network = canopen.Network(can.Bus(channel, interface="virtual"))
    network.NOTIFIER_CYCLE = 0.05  # how long its reader takes to end
    with network.connect():
        network.create_node(9, canopen.ObjectDictionary())
        (stranger,) = scan_bus(can.Bus(channel, interface="virtual"), MonotonicClock())
    assert (stranger.node_id, stranger.is_cell, stranger.state) == (9, False, None)
    assert stranger.problem.startswith("node 9, 0x1008:0")


def test_what_is_written_is_read_back(commissioning) -> None:
    commissioning.write(2, 0x2000, 0, 8_000)
    assert commissioning.read(2, 0x2000) == 8_000
    assert commissioning.read(1, 0x2000) == 13_000


def test_a_negative_value_keeps_its_sign(commissioning) -> None:
    commissioning.write(1, 0x60FF, 0, -123_456)
    assert commissioning.read(1, 0x60FF) == -123_456


def test_a_refusal_names_node_object_and_reason(commissioning) -> None:
    with pytest.raises(RefusedError, match=r"node 1, 0x1000:0 Device type: refused, .*0x0601"):
        commissioning.write(1, 0x1000, 0, 1)


def test_a_value_out_of_range_is_not_even_sent(commissioning) -> None:
    with pytest.raises(OutOfRangeError, match="0x2000"):
        commissioning.write(1, 0x2000, 0, 100_001)
    with pytest.raises(KeyError, match="no object 0x5FFF:0"):
        commissioning.read(1, 0x5FFF)


def test_answers_right_behind_a_sync_are_all_received(commissioning, served_cells) -> None:
    """canopen-python/canopen#623: nothing is asked twice, and no answer is missed."""
    requests, over = [], threading.Event()

    def produce() -> None:
        with served_cells.open() as bus:
            message = None
            while message is not None or not over.is_set():
                # Behind each request, and so before its answer, there are SYNCs.
                bus.send(can.Message(arbitration_id=cob.SYNC, is_extended_id=False))
                message = bus.recv(0.001)
                if message is not None and message.arbitration_id == cob.SDO_REQUEST_BASE + 2:
                    requests.append(bytes(message.data))

    producer = threading.Thread(target=produce)
    producer.start()
    try:
        answers = [commissioning.read(2, 0x2000) for _ in range(50)]
    finally:
        over.set()
        producer.join()
    assert answers == [13_000] * 50
    assert len(requests) == 50


def test_a_node_that_is_not_there_is_silent(commissioning) -> None:
    with pytest.raises(SilentError, match="node 77"):
        commissioning.read(77, 0x2000)


def test_nmt_commands_reach_one_node(commissioning) -> None:
    commissioning.command(nmt.START, 2)
    clock = MonotonicClock()
    while commissioning.states.get(2) != nmt.OPERATIONAL:
        clock.sleep(0.01)
        assert clock.now_s() < 5.0
    assert commissioning.states.get(1, nmt.PRE_OPERATIONAL) == nmt.PRE_OPERATIONAL


def test_a_frame_at_the_first_moment_is_heard(monkeypatch) -> None:
    class EagerLink:
        """Delivers before its maker has it, as a reader may."""

        def __init__(self, bus, clock, deliver) -> None:
            deliver(nmt.heartbeat(5, nmt.OPERATIONAL), clock.now_s())

    monkeypatch.setattr("mdms_host.commissioning.network.Link", EagerLink)
    assert Commissioning(None, MonotonicClock()).states == {5: nmt.OPERATIONAL}
