"""SLCAN, the line protocol of serial CAN adapters (Lawicel CAN232): bytes in, frames and lines out.

Data frames with identifiers of 11 bits are sent, and others are refused. Two lines go beyond the
protocol. A line `xNNNN` reports the number of bus frames that did not fit on their way to the host.
A line `y` reports bus-off: the last frames taken from the host may not have gone out.
"""

from binascii import hexlify, unhexlify

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
    """The adapter's side of the protocol; `send(can_id, data)` is whether the bus has room.

    `status` collects the bits that F reports and clears. `serial` is what N shows, four characters.
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
