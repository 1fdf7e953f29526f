"""Joins a board's CAN bus and a serial line: turns of a loop, as a cell's runner has them."""

from mdms_adapter import slcan

#: Bytes that may wait for the host: 4 ms of a full bus.
PENDING_MAX = 1024
#: Frames taken from the bus in a turn, and bytes from the host: neither starves the other.
FRAMES_PER_TURN = 16
BYTES_PER_TURN = 256
_OPERATIONAL = 5
_CLOSED = 127


class Adapter:
    """A board as an adapter; its wheels stay off, because nothing starts them.

    `bus` has `inbox`, `send(can_id, data)`, `service(now_ms)` and `off`, as `boards.bus.Bus`.
    `port` has `read(most)`, which returns bytes or b"", and `write(data)`, which returns the number
    of bytes taken. Neither waits. Frames that the host reads too late are dropped and counted, and
    a report takes their place. While the bus is off, frames are refused: after it they would come
    too late.
    """

    def __init__(self, bus, port, serial):
        self._bus = bus
        self._port = port
        self._slcan = slcan.Slcan(self._send, b"%04X" % (serial & 0xFFFF))
        self._pending = bytearray()
        self._dropped = 0
        self._overrun = bus.inbox.lost
        self._was_off = False
        self.lost = 0

    @property
    def state(self):
        """The NMT state that the LEDs show: operational while the channel is open."""
        return _OPERATIONAL if self._slcan.is_open else _CLOSED

    def turn(self, now_ms):
        """One turn of the background loop."""
        self._bus.service(now_ms)
        self._look_for_bus_off()
        self._receive(now_ms)
        # A host that writes and does not read is left waiting.
        if len(self._pending) <= PENDING_MAX:
            self._pending += self._slcan.feed(self._port.read(BYTES_PER_TURN))
        self._flush()

    def _send(self, can_id, data):
        return not self._bus.off and self._bus.send(can_id, data)

    def _look_for_bus_off(self):
        """Drop the frames of the host that are still to be sent, since the bus is off."""
        off = self._bus.off
        if off:
            self._slcan.status |= slcan.BUS_OFF
            if not self._was_off and self._slcan.is_open:
                self._pending += slcan.CUT
        self._was_off = off

    def _receive(self, now_ms):
        """Frames of the bus become lines."""
        inbox = self._bus.inbox
        self._count_overrun(inbox)
        self._report_losses()
        for _ in range(FRAMES_PER_TURN):
            frame = inbox.peek()
            if frame is None:
                break
            inbox.pop()
            # The inbox keeps 11 bits of an identifier.
            if self._slcan.is_open and not frame[2] & slcan.EXTENDED:
                self._put(self._slcan.line(frame[0], frame[1], frame[2], now_ms))
        self._report_losses()

    def _report_losses(self):
        """Report them once there is room for frames again, which go out behind the report."""
        if self._dropped and len(self._pending) < PENDING_MAX // 2:
            self._pending += self._slcan.lost(self._dropped)
            self._dropped = 0

    def _count_overrun(self, inbox):
        """Frames that the controller or its interrupt lost are lost to the host too."""
        if inbox.lost != self._overrun:
            self._slcan.status |= slcan.RECEIVE_FULL
            if self._slcan.is_open:
                self._drop(inbox.lost - self._overrun)
            self._overrun = inbox.lost

    def _put(self, line):
        # Once one is dropped, its loss is reported before the next goes out.
        if self._dropped or len(self._pending) + len(line) > PENDING_MAX:
            self._drop(1)
        else:
            self._pending += line

    def _drop(self, count):
        self._dropped += count
        self.lost += count

    def _flush(self):
        """Write to the host as much as it takes."""
        if self._pending:
            taken = self._port.write(self._pending)
            if taken:
                self._pending = self._pending[taken:]
