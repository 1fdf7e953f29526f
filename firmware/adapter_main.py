"""Makes the board an SLCAN adapter over USB; copied as `main.py` instead of the cell's.

`docs/boards.md` has the way to the prompt. Both wheels stay off.

SLCAN is the line protocol of serial CAN adapters (Lawicel CAN232). Data frames with identifiers of
11 bits are sent, and others are refused. Two lines go beyond the protocol. A line `xNNNN` reports
the number of bus frames that did not fit on their way to the host. A line `y` reports bus-off: the
last frames taken from the host may not have gone out.
"""

import gc
import select
import sys
import time
from binascii import hexlify, unhexlify

from mdms_cell.queues import Inbox

OK = b"\r"
ERROR = b"\x07"
#: The bus went off.
CUT = b"y\r"
#: Flags of `machine.CAN`, as the inbox keeps them.
REMOTE = 1
EXTENDED = 2

#: The longest line that is understood: t, 3 digits, length, 16 digits of data.
_LINE_MAX = 26
_END = 13
#: The only speed of the bus: 1 Mbit/s.
_SPEED = b"S8"
_VERSION = b"V0100\r"
_LOST_MOST = 0xFFFF
_STAMP_PERIOD_MS = 60_000

# Bits of the answer to F, since it was asked last
RECEIVE_FULL = 1
SEND_FULL = 2
OVERRUN = 8
BUS_OFF = 128


class Slcan:
    """The adapter's side of the protocol: bytes of the host in, answers and lines out.

    `send(can_id, data)` is whether the bus has room. `status` collects the bits that F reports and
    clears. `serial` is what N shows, four characters.
    """

    def __init__(self, send, serial):
        self.is_open = False
        self.listens_only = False
        self.status = 0
        self._send = send
        self._serial = serial
        self._stamped = False
        self._line = bytearray()
        self._overlong = False

    def feed(self, data):
        """Take in bytes; return what to answer."""
        answers = b""
        for byte in data:
            if byte == _END:
                answers += self._answer()
            elif len(self._line) < _LINE_MAX:
                self._line.append(byte)
            else:
                self._overlong = True
        return answers

    def line(self, can_id, data, flags, now_ms):
        """A received frame of 11 bits as a line for the host."""
        if flags & REMOTE:
            line = b"r%03X%d" % (can_id, len(data))
        else:
            line = b"t%03X%d" % (can_id, len(data)) + hexlify(data).upper()
        if self._stamped:
            line += b"%04X" % (now_ms % _STAMP_PERIOD_MS)
        return line + OK

    def lost(self, count):
        """A line that says how many frames were dropped."""
        self.status |= OVERRUN
        return b"x%04X\r" % min(count, _LOST_MOST)

    def _answer(self):
        """The answer to a line, which begins anew."""
        line = bytes(self._line)
        overlong = self._overlong
        self._line = bytearray()
        self._overlong = False
        if overlong:
            return ERROR
        # Hosts send empty lines to end a line that was cut off before.
        if not line:
            return OK
        try:
            return self._obey(line)
        except ValueError:
            return ERROR

    def _obey(self, line):
        command = line[:1]
        if command == b"t":
            return self._transmit(line)
        if command == b"F" and len(line) == 1:
            status = self.status
            self.status = 0
            return b"F%02X\r" % status
        if line in (b"V", b"v"):
            return _VERSION
        if line == b"N":
            return b"N" + self._serial + OK
        return self._set_up(line)

    def _set_up(self, line):
        """The commands that open, close and prepare the channel."""
        if line == b"C":
            self.is_open = False
            return OK
        if self.is_open:
            return ERROR
        if line in (b"O", b"L"):
            self.is_open = True
            self.listens_only = line == b"L"
            return OK
        if line in (b"Z0", b"Z1"):
            self._stamped = line == b"Z1"
            return OK
        # Acceptance code and mask are taken, and let all through.
        known = line == _SPEED or (line[:1] in (b"M", b"m") and len(line) == 9)
        return OK if known else ERROR

    def _transmit(self, line):
        """Send a frame. Raises ValueError for a character that is no digit."""
        if not self.is_open or self.listens_only or len(line) < 5:
            return ERROR
        # `int` would take a sign or a space for a digit.
        can_id = int.from_bytes(unhexlify(b"0" + line[1:4]), "big")
        size = int(line[4:5])
        digits = line[5:]
        if can_id > 0x7FF or size > 8 or len(digits) != 2 * size:
            return ERROR
        if not self._send(can_id, unhexlify(digits)):
            self.status |= SEND_FULL
            return ERROR
        return b"z\r"


# The loop -----------------------------------------------------------------------------------------

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
        self._slcan = Slcan(self._send, b"%04X" % (serial & 0xFFFF))
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
            self._slcan.status |= BUS_OFF
            if not self._was_off and self._slcan.is_open:
                self._pending += CUT
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
            if self._slcan.is_open and not frame[2] & EXTENDED:
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
            self._slcan.status |= RECEIVE_FULL
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


# The program --------------------------------------------------------------------------------------

#: Frames that may wait while the program does something else: 60 ms of a full bus.
INBOX_SIZE = 512


def run(board, line):
    """Carry frames until the board is switched off."""
    bus = board.bus
    bus.inbox = Inbox(INBOX_SIZE)
    bus.listen(None)
    adapter = Adapter(bus, line, board.serial)
    gc.collect()
    bus.start()
    while True:
        now_ms = time.ticks_ms()
        adapter.turn(now_ms)
        board.show(now_ms, adapter.state, adapter.lost)


def port():
    """The serial line to the host: USB as an STM32 board has it, or standard input and output.

    Ctrl-C in it is a byte like any other from here on.
    """
    import micropython

    micropython.kbd_intr(-1)
    try:
        from pyb import USB_VCP
    except ImportError:
        return StandardPort()
    usb = USB_VCP()
    usb.setinterrupt(-1)
    return UsbPort(usb)


class UsbPort:
    """A `pyb.USB_VCP`; it reads and writes as many bytes as there are."""

    def __init__(self, usb):
        self._usb = usb

    def read(self, most):
        """Bytes that have come, b"" if none have."""
        return self._usb.recv(most, timeout=0)

    def write(self, data):
        """How many bytes were taken; none while no host has the port open."""
        return self._usb.send(data, timeout=0) if self._usb.isconnected() else len(data)


class StandardPort:
    """Standard input and output, which are asked before each byte, and before each piece."""

    #: Bytes that an output takes without waiting once it is ready.
    PIECE = 512

    def __init__(self):
        self._input = sys.stdin.buffer
        self._output = sys.stdout.buffer
        self._ready = select.poll()
        self._ready.register(self._input, select.POLLIN)
        self._room = select.poll()
        self._room.register(self._output, select.POLLOUT)

    def read(self, most):
        """Bytes that have come, b"" if none have. Raises EOFError when the other end is gone."""
        data = bytearray()
        while len(data) < most and self._ready.poll(0):
            byte = self._input.read(1)
            if not byte:
                raise EOFError
            data += byte
        return data

    def write(self, data):
        """How many bytes were taken."""
        if not self._room.poll(0):
            return 0
        return self._output.write(data[: self.PIECE])


if __name__ == "__main__":
    from boards.detect import board_module

    module = board_module(sys.implementation._machine)
    if not module.held():
        run(module.board(), port())
