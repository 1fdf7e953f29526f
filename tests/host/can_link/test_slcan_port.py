"""A serial adapter's line on a real pseudo-terminal and on a real TCP connection."""

import os
import socket
import tty
from contextlib import contextmanager
from threading import Thread

import can
import pytest

from mdms_host.can_link.link import Link
from mdms_host.clock import MonotonicClock
from mdms_protocol.codecs.frame import Frame

FRAMES = 500
PATIENCE_S = 60.0


@contextmanager
def terminal():
    far, near = os.openpty()
    tty.setraw(near)
    tty.setraw(far)
    yield os.ttyname(near), lambda: far
    os.close(far)
    os.close(near)


@contextmanager
def tcp():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        accepted = []

        def far():
            if not accepted:
                accepted.append(listener.accept()[0])
            return accepted[0].fileno()

        yield f"socket://127.0.0.1:{listener.getsockname()[1]}", far
        for each in accepted:
            each.close()


@pytest.fixture(params=[terminal, tcp])
def adapter(request):
    """A link to an adapter, and the descriptor of the adapter's end."""
    with request.param() as (channel, far):
        bus = can.Bus(channel, interface="slcan", sleep_after_open=0)
        with Link(bus, MonotonicClock()) as link:
            yield link, far()


def received(link, count):
    frames, clock = [], MonotonicClock()
    while len(frames) < count and clock.now_s() < PATIENCE_S:
        link.receive(0.1, lambda frame, _now_s: frames.append(frame))
    return frames


def test_a_frame_costs_less_than_one_read(adapter, monkeypatch):
    """python-can reads byte by byte: with a whole array on the bus that takes most of a core."""
    link, far = adapter
    reads, read, recv = [], os.read, socket.socket.recv
    monkeypatch.setattr(os, "read", lambda *args: reads.append(1) or read(*args))
    monkeypatch.setattr(socket.socket, "recv", lambda *args: reads.append(1) or recv(*args))
    cycle = b"".join(b"t%03X8%016X\r" % (0x180 + cell, cell) for cell in range(1, 19))
    writer = Thread(target=lambda: [os.write(far, cycle) for _ in range(FRAMES // 18)])
    writer.start()
    frames = received(link, FRAMES // 18 * 18)
    writer.join()
    assert frames[:2] == [Frame(0x181, bytes(7) + b"\x01"), Frame(0x182, bytes(7) + b"\x02")]
    assert len(frames) == FRAMES // 18 * 18 > len(reads)


def test_frames_arrive_whole_however_their_bytes_come(adapter):
    link, far = adapter
    for byte in b"\rz\rt70", b"1105\rt", b"1810", b"\rV1013\rt182", b"2FFfe\r":
        os.write(far, byte)
    assert received(link, 3) == [
        Frame(0x701, b"\x05"),
        Frame(0x181, b""),
        Frame(0x182, b"\xff\xfe"),
    ]
    assert link.garbled == 0


def test_noise_is_counted_and_costs_no_other_frame(adapter):
    link, far = adapter
    os.write(far, b"t701105\rt70Z1\rt+01105\r\xff\xfe\rt7018\r" + b"?" * 200 + b"\rt702105\r")
    assert received(link, 2) == [Frame(0x701, b"\x05"), Frame(0x702, b"\x05")]
    assert link.garbled >= 4
    assert "garbage was received" in link.incidents[0][1]


def test_frames_without_room_in_our_own_adapter_are_an_incident(adapter):
    link, far = adapter
    os.write(far, b"x0102\rt701105\r")
    assert received(link, 1) == [Frame(0x701, b"\x05")]
    assert link.garbled == 1
    assert "the adapter has dropped 258 frames of the bus" in link.incidents[0][1]


def test_bus_off_of_our_own_adapter_is_an_incident(adapter):
    link, far = adapter
    os.write(far, b"y\rt701105\r")
    assert received(link, 1) == [Frame(0x701, b"\x05")]
    assert "the adapter went off the bus; frames sent last may be lost" in link.incidents[0][1]


def test_frames_that_the_adapter_refuses_are_counted(adapter):
    link, far = adapter
    link.send(Frame(0x201, b"\x01"))
    os.write(far, b"\at701105\rz\r")
    assert received(link, 1) == [Frame(0x701, b"\x05")]
    assert link.unsent == 1


def test_an_adapter_that_takes_no_bytes_any_more_is_closed_all_the_same():
    with terminal() as (channel, _far):
        link = Link(can.Bus(channel, interface="slcan", sleep_after_open=0), MonotonicClock())
        while not link.unsent:
            link.send(Frame(0x201, bytes(8)))
        closing = Thread(target=link.close, daemon=True)
        closing.start()
        closing.join(PATIENCE_S / 2)
        assert not closing.is_alive()
