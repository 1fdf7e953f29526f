"""One node's controller, bit by bit: its next bit, after the bits that it has seen (ISO 11898-1).

A receiver checks stuffing, length and CRC. Each phase is a generator that yields the level to
drive, is sent the level seen at that bit, and returns the phase that follows. A counter that makes
a node passive does so from the next flag on.
"""

from collections.abc import Callable, Generator, Iterable
from enum import Enum
from functools import partial

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.controller import Confinement, ErrorState
from mdms_sim.bus.identifier import EXTENDED, REMOTE
from mdms_sim.bus.wire import (
    CRC_BITS,
    CRC_MASK,
    CRC_POLYNOMIAL,
    INTERFRAME_BITS,
    STUFF_RUN,
    stuffed_bits,
)

#: Places in a frame without stuff bits, from start of frame; the header ends with the data length.
_IDE = 13
_STANDARD_HEADER, _STANDARD_RTR = 19, 12
_EXTENDED_HEADER, _EXTENDED_RTR = 39, 32
_LENGTH_BITS = 4
_LONGEST_DATA = 8


class FrameProgress(Enum):
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
        """The content of a whole frame."""
        bits = self._bits
        header, remote, size = _shape(bits)
        if bits[_IDE]:
            can_id = EXTENDED | _number(bits[1:12] + bits[14:_EXTENDED_RTR])
        else:
            can_id = _number(bits[1:_STANDARD_RTR])
        if remote:
            return Frame(can_id | REMOTE, bytes(size))
        return Frame(can_id, _number(bits[header : header + 8 * size]).to_bytes(size, "big"))

    def take(self, bit: int) -> FrameProgress:
        """Reads the next bit."""
        if self._run == STUFF_RUN:
            if bit == self._last:
                return FrameProgress.STUFF_ERROR
            self._run = 1
        else:
            self._bits.append(bit)
            self._run = self._run + 1 if bit == self._last else 1
            self._wanted = self._wanted or self._length()
        self._last = bit
        whole = len(self._bits) == self._wanted and not self.stuffing
        return FrameProgress.WHOLE if whole else FrameProgress.MORE

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


DOMINANT, RECESSIVE = 0, 1
FLAG_BITS = 6
DELIMITER_BITS = 8
END_OF_FRAME_BITS = 7
#: So many dominant bits after a flag are borne without counting them as errors.
PATIENCE_BITS = 8
#: Start of frame to the last bit that others may overwrite, without stuff bits.
STANDARD_ARBITRATION_BITS, EXTENDED_ARBITRATION_BITS = 13, 33

Phase = Callable[[], Generator[int, int, "Phase"]]


class Node:
    """A controller from the start of a frame on; with a `frame` it sends it, else it listens.

    `errors` are its counters, which it moves; it asks for so many `overloads`. `drive` is its level
    for the next bit, `seen` all bits so far.
    `sent_after` and `heard_after` count the bits to the end of a frame that was good for it, and
    `heard` is that frame; `idle_after` counts those until it would let a new frame begin. All are
    None before. `outvoted`: it has lost arbitration, `flagged`: it has
    destroyed a frame.
    """

    def __init__(
        self,
        errors: Confinement,
        frame: Frame | None = None,
        *,
        overloads: int = 0,
        seen: Iterable[int] = (),
    ) -> None:
        self.errors = errors
        self.frame = frame
        self.seen: list[int] = []
        self.sent_after: int | None = None
        self.heard_after: int | None = None
        self.heard: Frame | None = None
        self.idle_after: int | None = None
        self.outvoted = False
        self.flagged = False
        self._overloads = overloads
        self._transmits = False
        self._unacknowledged = False
        self._active = True
        self._reader = Reader()
        self._life = self._live(self._rest if frame is None else partial(self._send, frame))
        self.drive = next(self._life)
        for bit in seen:
            self.see(bit)

    def see(self, bit: int) -> None:
        """The next bit has passed."""
        self.seen.append(bit)
        self.drive = self._life.send(bit)

    def _live(self, phase: Phase) -> Generator[int, int, None]:
        while True:
            phase = yield from phase()

    # When all is well

    def _rest(self) -> Generator[int, int, Phase]:
        """The bus is idle."""
        self._transmits = False
        self.idle_after = len(self.seen)
        while (yield RECESSIVE):
            pass
        return self._start_of_frame()

    def _start_of_frame(self) -> Phase:
        self.idle_after = None
        self._transmits = False
        self._reader = Reader()
        self._reader.take(DOMINANT)
        return self._receive

    def _send(self, frame: Frame) -> Generator[int, int, Phase]:
        self._transmits = True
        reader = self._reader
        for bit in stuffed_bits(frame):
            seen = yield bit
            if seen != bit:
                return self._contradicted(frame, seen)
            reader.take(seen)
        if not (yield RECESSIVE):  # the delimiter of the CRC
            return self._error()
        if (yield RECESSIVE):
            return self._error(unacknowledged=True)
        for _ in range(1 + END_OF_FRAME_BITS):
            if not (yield RECESSIVE):
                return self._error()
        self.sent_after = len(self.seen)
        self.errors.transmitted()
        return self._intermission

    def _contradicted(self, frame: Frame, seen: int) -> Phase:
        """The bit on the wire is not the bit that was sent."""
        reader = self._reader
        extended = frame.can_id & EXTENDED
        arbitration = EXTENDED_ARBITRATION_BITS if extended else STANDARD_ARBITRATION_BITS
        if seen == RECESSIVE or reader.position >= arbitration:
            return self._error()
        if reader.stuffing:
            return self._error(counts=False)
        self.outvoted = True
        self._transmits = False
        reader.take(seen)
        return self._receive

    def _receive(self) -> Generator[int, int, Phase]:
        reader = self._reader
        progress = FrameProgress.MORE
        while progress is FrameProgress.MORE:
            progress = reader.take((yield RECESSIVE))
        if progress is FrameProgress.STUFF_ERROR or not (yield RECESSIVE):
            return self._error()
        good = reader.good
        answer = DOMINANT if good else RECESSIVE
        if (yield answer) > answer:
            return self._error()
        if good:
            self.errors.received()
        if not (yield RECESSIVE) or not good:
            return self._error()
        for _ in range(END_OF_FRAME_BITS - 1):
            if not (yield RECESSIVE):
                return self._error()
        # The last bit does not matter to who receives.
        self.heard, self.heard_after = reader.frame, len(self.seen) + 1
        return self._intermission if (yield RECESSIVE) else self._overload

    def _intermission(self) -> Generator[int, int, Phase]:
        if self._overloads:
            self._overloads -= 1
            return self._overload
        for left in range(INTERFRAME_BITS, 0, -1):
            if not (yield RECESSIVE):
                return self._overload if left > 1 else self._start_of_frame()
        return self._rest

    # When it is not

    def _error(self, *, counts: bool = True, unacknowledged: bool = False) -> Phase:
        """The node has found an error, and signals it from the next bit on."""
        self._active = self.errors.state is ErrorState.ACTIVE
        self._unacknowledged = unacknowledged and not self._active
        if counts and not self._unacknowledged:
            self._count(self.errors.receive_error)
        return self._flag

    def _count(self, receive: Callable[[], None]) -> None:
        if self._transmits:
            self.errors.transmit_error()
        else:
            receive()

    def _flag(self) -> Generator[int, int, Phase]:
        return (yield from self._active_flag() if self._active else self._passive_flag())

    def _active_flag(self) -> Generator[int, int, Phase]:
        self.flagged = True
        for _ in range(FLAG_BITS):
            if (yield DOMINANT):
                self._count(self.errors.receive_severe_error)
                return self._flag
        return self._error_delimiter

    def _passive_flag(self) -> Generator[int, int, Phase]:
        """Six equal bits of whoever; a lone sender that nobody answers is not to blame."""
        run, last = 0, RECESSIVE
        while run < FLAG_BITS:
            seen = yield RECESSIVE
            if not seen and self._unacknowledged:
                self._unacknowledged = False
                self.errors.transmit_error()
            run = run + 1 if seen == last else 1
            last = seen
        return self._error_delimiter

    def _error_delimiter(self) -> Generator[int, int, Phase]:
        if (yield RECESSIVE):
            return (yield from self._delimiter())
        if not self._transmits:
            # Others only answer, so the fault was likely its own.
            self._count(self.errors.receive_severe_error)
        return (yield from self._patience(1))

    def _overload(self) -> Generator[int, int, Phase]:
        for _ in range(FLAG_BITS):
            if (yield DOMINANT):
                self._active = self.errors.state is ErrorState.ACTIVE
                self._count(self.errors.receive_severe_error)
                return self._flag
        return (yield from self._patience(0))

    def _patience(self, dominant: int) -> Generator[int, int, Phase]:
        """Waits for the first recessive bit after a flag."""
        while not (yield RECESSIVE):
            dominant += 1
            if dominant % PATIENCE_BITS == 0:
                self._count(self.errors.receive_severe_error)
        return (yield from self._delimiter())

    def _delimiter(self) -> Generator[int, int, Phase]:
        """The rest of a delimiter after its first bit."""
        for left in range(DELIMITER_BITS - 1, 0, -1):
            if not (yield RECESSIVE):
                return self._overload if left == 1 else self._error()
        return self._intermission
