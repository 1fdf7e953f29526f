"""What a receiver makes of the bits of a frame: stuffing, length, CRC (ISO 11898-1)."""

from enum import Enum

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.wire import CRC_BITS, CRC_MASK, CRC_POLYNOMIAL, EXTENDED, REMOTE, STUFF_RUN

#: Places in a frame without stuff bits, from start of frame; the header ends with the data length.
_IDE = 13
_STANDARD_HEADER, _STANDARD_RTR = 19, 12
_EXTENDED_HEADER, _EXTENDED_RTR = 39, 32
_LENGTH_BITS = 4
_LONGEST_DATA = 8


class Progress(Enum):
    """How far a frame is read."""

    MORE = "more bits to come"
    WHOLE = "that was the end of the CRC"
    STUFF_ERROR = "a sixth equal bit"


class Reader:
    """Takes the bits of one frame from its start to the end of its CRC, stuff bits included."""

    __slots__ = ("_bits", "_last", "_run", "_wanted")

    def __init__(self) -> None:
        self._bits: list[int] = []
        self._run = 0
        self._last = 1
        self._wanted: int | None = None

    @property
    def position(self) -> int:
        """How many bits have been read, without stuff bits."""
        return len(self._bits)

    @property
    def stuffing(self) -> bool:
        """Whether the next bit is a stuff bit."""
        return self._run == STUFF_RUN

    @property
    def good(self) -> bool:
        """Whether the CRC of a whole frame is right."""
        return _remainder(self._bits) == 0

    @property
    def frame(self) -> Frame:
        """What a whole frame says."""
        bits = self._bits
        header, remote, size = _shape(bits)
        if bits[_IDE]:
            can_id = EXTENDED | _number(bits[1:12] + bits[14:_EXTENDED_RTR])
        else:
            can_id = _number(bits[1:_STANDARD_RTR])
        if remote:
            return Frame(can_id | REMOTE, bytes(size))
        return Frame(can_id, _number(bits[header : header + 8 * size]).to_bytes(size, "big"))

    def take(self, bit: int) -> Progress:
        """Reads the next bit."""
        if self._run == STUFF_RUN:
            if bit == self._last:
                return Progress.STUFF_ERROR
            self._run = 1
        else:
            self._bits.append(bit)
            self._run = self._run + 1 if bit == self._last else 1
            self._wanted = self._wanted or self._length()
        self._last = bit
        whole = len(self._bits) == self._wanted and not self.stuffing
        return Progress.WHOLE if whole else Progress.MORE

    def _length(self) -> int | None:
        """Bits from start of frame to the end of the CRC, as soon as that is decided."""
        bits = self._bits
        if len(bits) < _STANDARD_HEADER or (bits[_IDE] and len(bits) < _EXTENDED_HEADER):
            return None
        header, remote, size = _shape(bits)
        return header + (0 if remote else 8 * size) + CRC_BITS


def _shape(bits: list[int]) -> tuple[int, int, int]:
    """Length of the header [bits], whether it is a remote frame, and the data's length [bytes]."""
    header, remote = _STANDARD_HEADER, _STANDARD_RTR
    if bits[_IDE]:
        header, remote = _EXTENDED_HEADER, _EXTENDED_RTR
    return header, bits[remote], min(_number(bits[header - _LENGTH_BITS : header]), _LONGEST_DATA)


def _number(bits: list[int]) -> int:
    number = 0
    for bit in bits:
        number = number << 1 | bit
    return number


def _remainder(frame: list[int]) -> int:
    crc = 0
    for bit in frame:
        crc = (crc << 1 | bit) ^ (CRC_POLYNOMIAL | 1 << CRC_BITS if crc >> (CRC_BITS - 1) else 0)
    return crc & CRC_MASK
