"""Transmit queues that are full: SocketCAN's, a serial line's, a USB adapter's."""

import errno
import os
import re
import select
import socket
import threading
import tty

import can
import pytest
import serial
from can.interfaces.socketcan import SocketcanBus

from mdms_host.can_link.link import Link, is_full
from mdms_host.can_link.links import Links
from mdms_host.clock import MonotonicClock
from mdms_protocol.codecs.frame import Frame

SETPOINT = Frame(0x201, bytes(range(8)))
FRAME_S = 135e-6


class SteppedClock:
    """Time passes in `sleep` only."""

    is_real = False

    def __init__(self):
        self.time_s = 0.0

    def now_s(self):
        return self.time_s

    def sleep(self, seconds):
        self.time_s += seconds


class QueueOfTen(socket.socket):
    """A raw CAN socket before an interface with `txqueuelen 10`, on a bus of 1 Mbit/s.

    As the kernel's it is always ready to be written to, and `send` fails when the queue is full.
    """

    def __init__(self, clock, acknowledged=True):
        super().__init__(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.sent = []
        self._clock = clock
        self._acknowledged = acknowledged
        self._ends_s = []

    def send(self, data):
        now_s = self._clock.now_s()
        if self._acknowledged:
            self._ends_s = [end_s for end_s in self._ends_s if end_s > now_s]
        if len(self._ends_s) == 10:
            raise OSError(errno.ENOBUFS, os.strerror(errno.ENOBUFS))
        self._ends_s.append(max([now_s, *self._ends_s]) + FRAME_S)
        self.sent.append(data)
        return len(data)


class Socketcan(SocketcanBus):
    """python-can's own SocketCAN interface on that socket; only opening it is left out."""

    def __init__(self, queue):
        self.socket = queue
        self.channel = "can0"
        self._bcm_sockets = {}
        self._is_filtered = False
        can.BusABC.__init__(self, "can0")

    def _recv_internal(self, timeout):
        threading.Event().wait(timeout)
        return None, False

    def _apply_filters(self, filters):
        self._is_filtered = True


def test_a_cycle_that_is_longer_than_socketcans_queue_goes_out_whole():
    clock = SteppedClock()
    queue = QueueOfTen(clock)
    with Link(Socketcan(queue), clock) as link:
        link.send_all([SETPOINT] * 54)
        assert (len(queue.sent), link.unsent) == (54, 0)
        assert link.counts.waited > 0
        assert clock.now_s() < 0.01


def test_a_queue_that_stays_full_is_shown_and_is_no_dead_device():
    clock = SteppedClock()
    queue = QueueOfTen(clock, acknowledged=False)
    with Link(Socketcan(queue), clock) as link:
        for _ in range(300):
            link.send_all([SETPOINT] * 18)
        assert (len(queue.sent), link.unsent) == (10, 300 * 18 - 10)
        # A cycle's frames wait for as long together as a cycle takes.
        assert clock.now_s() <= 300 * 0.011
        texts = [text for _, text in link.incidents]
        assert 3 <= len(texts) <= 4
        assert all("transmit queue stays full" in text for text in texts)
        assert "not sent" in str(link.counts)


class StuckLine(can.BusABC):
    """An adapter that takes no frame, and whose driver waits for room by itself."""

    def __init__(self, clock):
        super().__init__("stuck")
        self._clock = clock

    def send(self, msg, timeout=None):
        self._clock.sleep(timeout)
        raise can.CanTimeoutError("the adapter takes no frame")

    def _recv_internal(self, timeout):
        threading.Event().wait(timeout)
        return None, False


def test_a_line_that_waits_by_itself_takes_no_more_than_a_cycle_from_the_other_buses():
    clock = SteppedClock()
    queue = QueueOfTen(clock)
    with Links([Socketcan(queue), StuckLine(clock)], ["can0", "stuck"], clock) as links:
        links.send_all([(1, SETPOINT)] * 27 + [(0, SETPOINT)] * 10)
        assert len(queue.sent) == 10
        assert clock.now_s() < 0.015


def test_a_serial_line_that_is_not_read_for_a_while_gets_whole_lines_and_no_half_ones():
    far, near = os.openpty()
    tty.setraw(near)
    tty.setraw(far)
    lines = bytearray()
    with Link(
        can.Bus(os.ttyname(near), interface="slcan", sleep_after_open=0), MonotonicClock()
    ) as link:
        sent = 0
        while link.unsent < 10:
            link.send(SETPOINT)
            sent += 1
        lines += os.read(far, 1000)
        for _ in range(20):
            link.send(SETPOINT)
            sent += 1
        unsent = link.unsent
        while not lines.endswith(b"t2020\r"):
            lines += os.read(far, 1 << 16)
            if select.select([far], [], [], 0.1)[0] == []:
                link.send(Frame(0x202, b""))
    frames = [line for line in bytes(lines).split(b"\r")[:-1] if line.startswith(b"t")]
    assert all(re.fullmatch(rb"t20180001020304050607|t2020", line) for line in frames)
    assert sum(line == b"t20180001020304050607" for line in frames) == sent - unsent
    for end in (far, near):
        os.close(end)


class USBError(IOError):
    """As pyusb's: raised by a bulk transfer, with the system's number."""

    def __init__(self, text, error_code=None, number=None):
        super().__init__(number, text)
        self.backend_error_code = error_code


def caused(error, cause):
    error.__cause__ = cause
    return error


@pytest.mark.parametrize(
    ("error", "full"),
    [
        (can.CanOperationError("Failed to transmit: No buffer space", errno.ENOBUFS), True),
        (can.CanOperationError("Transmit buffer full"), True),
        (can.CanOperationError("Not transmitted successfully: device disconnected"), False),
        (can.CanTimeoutError("no room"), True),
        (caused(can.CanOperationError("serial"), serial.SerialTimeoutException()), True),
        (caused(can.CanOperationError("not sent"), USBError("timed out", -7, 110)), True),
        (caused(can.CanOperationError("not sent"), USBError("No such device", -4, 19)), False),
        (can.CanOperationError("Failed to transmit: Network is down", errno.ENETDOWN), False),
        (caused(can.CanOperationError("serial"), serial.SerialException("write failed")), False),
        (OSError(errno.EIO, "Input/output error"), False),
    ],
)
def test_want_of_room_is_told_from_a_failing_device(error, full):
    assert is_full(error) is full
