"""SLCAN, the line protocol of serial CAN adapters (Lawicel CAN232), from the adapter's side.

Sans-IO: bytes in, frames and answers out. A line that makes no sense is answered by the error byte
and counted.
"""

import re
from collections.abc import Callable

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.identifier import EXTENDED, EXTENDED_MASK, REMOTE, STANDARD_MASK

OK = b"\r"
ERROR = b"\x07"
#: Longest line: T, 8 digits, length, 16 digits of data.
_LINE_MAX = 26
_VERSION = b"V1013\r"
_SERIAL = b"NMDMS\r"
_STATUS = b"F00\r"
_MS_PER_MINUTE = 60_000
_DATA_MAX = 8
#: Time quanta of an SJA1000 at 16 MHz.
_SJA1000_HZ = 8_000_000
#: Bit rates by the digit of `S` [kbit/s].
_SPEEDS = dict(enumerate((10, 20, 50, 100, 125, 250, 500, 800, 1000), ord("0")))
_HEX_DIGITS = frozenset(b"0123456789ABCDEFabcdef")
#: Letters of any adapter's lines, possible here or not; FD's letters included.
_SYNTAX = re.compile(
    rb"[SYWUQ][0-9]|s[0-9A-F]{1,8}|Z[0-9]|[Mm][0-9A-F]{8}|[OLCVvNFPA]|X[01]"
    rb"|[trdb][0-9A-F]{4,}|[TRDB][0-9A-F]{9,}",
    re.IGNORECASE,
)


class SlcanError(Exception):
    """A line is not SLCAN, or not now."""


class VirtualAdapter:
    """One adapter, a `Codec`: `send(frame) -> bool` gets the frames that a client wants on the bus.

    `garbage` counts lines that were refused, `sessions` open channels that were closed or opened
    again. `is_slcan` is False once something has come that is no line of this protocol at all.
    A channel that is opened at another bit rate than that of its bus hears nothing and sends
    nothing. A closed one has that of its bus until it is set. Timing registers are BTR0 and BTR1 of
    an SJA1000 at 16 MHz, as of the CAN232; those of other adapters have another length, and are
    always right.
    """

    greeting = b""

    def __init__(self, send: Callable[[Frame], bool], bitrate: int = 1_000_000) -> None:
        self.is_open = False
        self.garbage = 0
        self.sessions = 0
        self.is_slcan = True
        self._send = send
        self._bitrate = bitrate
        self._is_in_step = True
        self._listen_only = False
        self._stamped = False
        self._line = bytearray()
        self._overlong = False
        self._commands: dict[int, Callable[[bytes], bytes]] = {
            ord("S"): self._set_speed,
            ord("s"): self._set_timing,
            ord("O"): self._open,
            ord("L"): self._listen,
            ord("C"): self._close,
            ord("t"): self._transmit,
            ord("T"): self._transmit,
            ord("r"): self._transmit,
            ord("R"): self._transmit,
            ord("Z"): self._set_stamps,
            ord("V"): lambda _: _VERSION,
            ord("v"): lambda _: _VERSION,
            ord("N"): lambda _: _SERIAL,
            ord("F"): lambda _: _STATUS,
            ord("M"): lambda _: OK,
            ord("m"): lambda _: OK,
        }

    def feed(self, data: bytes) -> bytes:
        """Take in bytes from the client; return what to answer."""
        *lines, rest = data.split(OK)
        answers = bytearray()
        for line in lines:
            self._take(line)
            answers += self._answer()
        self._take(rest)
        return bytes(answers)

    def _take(self, piece: bytes) -> None:
        room = _LINE_MAX - len(self._line)
        self._line += piece[:room]
        if len(piece) > room:
            self._overlong, self.is_slcan = True, False

    def encode(self, frame: Frame, sim_ns: int) -> bytes:
        """A received frame as a line for the client; nothing while the channel is closed."""
        if not (self.is_open and self._is_in_step) or frame.can_id & ~(
            EXTENDED | REMOTE | EXTENDED_MASK
        ):
            return b""
        remote = frame.can_id & REMOTE
        if frame.can_id & EXTENDED:
            head = f"{'R' if remote else 'T'}{frame.can_id & EXTENDED_MASK:08X}"
        else:
            head = f"{'r' if remote else 't'}{frame.can_id & STANDARD_MASK:03X}"
        body = "" if remote else frame.data.hex().upper()
        stamp = f"{sim_ns // 1_000_000 % _MS_PER_MINUTE:04X}" if self._stamped else ""
        return f"{head}{len(frame.data)}{body}{stamp}\r".encode()

    def _answer(self) -> bytes:
        line, overlong = bytes(self._line), self._overlong
        self._line.clear()
        self._overlong = False
        # Clients send empty lines to end a half-sent one.
        if not line and not overlong:
            return OK
        try:
            if overlong or not _SYNTAX.fullmatch(line):
                self.is_slcan = False
                raise SlcanError
            if line[0] not in self._commands:
                raise SlcanError
            return self._commands[line[0]](line)
        except (SlcanError, ValueError):
            self.garbage += 1
            return ERROR

    def _set_speed(self, line: bytes) -> bytes:
        if self.is_open or len(line) != 2 or line[1] not in _SPEEDS:
            raise SlcanError
        self._is_in_step = 1000 * _SPEEDS[line[1]] == self._bitrate
        return OK

    def _set_timing(self, line: bytes) -> bytes:
        if self.is_open:
            raise SlcanError
        _require_hex(line[1:])
        prescaler, segments = int(line[1:3], 16) & 0x3F, int(line[3:5] or b"0", 16)
        quanta = (prescaler + 1) * (3 + (segments & 0xF) + (segments >> 4 & 7))
        self._is_in_step = len(line) != 5 or quanta * self._bitrate == _SJA1000_HZ
        return OK

    def _set_stamps(self, line: bytes) -> bytes:
        if self.is_open or line[1:] not in (b"0", b"1"):
            raise SlcanError
        self._stamped = line[1:] == b"1"
        return OK

    def _open(self, line: bytes) -> bytes:
        return self._begin(listen_only=False)

    def _listen(self, line: bytes) -> bytes:
        return self._begin(listen_only=True)

    def _begin(self, *, listen_only: bool) -> bytes:
        self.sessions += self.is_open
        self.is_open, self._listen_only = True, listen_only
        return OK

    def _close(self, line: bytes) -> bytes:
        self.sessions += self.is_open
        self.is_open, self._is_in_step = False, True
        return OK

    def _transmit(self, line: bytes) -> bytes:
        may_send = self.is_open and self._is_in_step and not self._listen_only
        if not may_send or not self._send(_frame_of(line)):
            raise SlcanError
        return b"z\r" if line[0] in b"tr" else b"Z\r"


def _frame_of(line: bytes) -> Frame:
    """The frame of a transmit command; raises SlcanError, or ValueError for missing digits."""
    _require_hex(line[1:])
    extended, remote = line[0] in b"TR", line[0] in b"rR"
    digits = 8 if extended else 3
    can_id = int(line[1 : 1 + digits], 16)
    size = int(line[1 + digits : 2 + digits], 16)
    data = bytes.fromhex(line[2 + digits :].decode("ascii"))
    if size > _DATA_MAX or can_id > (EXTENDED_MASK if extended else STANDARD_MASK):
        raise SlcanError
    if len(data) != (0 if remote else size) or len(line) != 2 + digits + 2 * len(data):
        raise SlcanError
    flags = (EXTENDED if extended else 0) | (REMOTE if remote else 0)
    return Frame(can_id | flags, bytes(size) if remote else data)


def _require_hex(digits: bytes) -> None:
    """Raise SlcanError for anything else than hexadecimal digits."""
    if not digits or not _HEX_DIGITS.issuperset(digits):
        raise SlcanError
