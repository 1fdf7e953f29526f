"""One node's controller, bit by bit: what it drives next after what it has seen (ISO 11898-1).

Each phase is a generator that yields the level to drive, is sent the level seen at that bit, and
returns the phase that follows. A counter that makes a node passive does so from the next flag on.
"""

from collections.abc import Callable, Generator, Iterable
from functools import partial

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.confinement import Confinement, ErrorState
from mdms_sim.bus.reception import Progress, Reader
from mdms_sim.bus.wire import EXTENDED, INTERFRAME_BITS, stuffed_bits

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

    `errors` are its counters, which it moves; a `mute` node only listens, and drives nothing. It
    asks for so many `overloads`. `drive` is its level for the next bit, `seen` all bits so far.
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
        mute: bool = False,
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
        self._mute = mute
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
        """What is on the wire is not what was sent."""
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
        progress = Progress.MORE
        while progress is Progress.MORE:
            progress = reader.take((yield RECESSIVE))
        if progress is Progress.STUFF_ERROR or not (yield RECESSIVE):
            return self._error()
        good = reader.good
        answer = DOMINANT if good and not self._mute else RECESSIVE
        if (yield answer) > answer:
            return self._error()
        if good and not self._mute:
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
        self._active = self.errors.state is ErrorState.ACTIVE and not self._mute
        self._unacknowledged = unacknowledged and not self._active
        if counts and not self._unacknowledged:
            self._count(self.errors.receive_error)
        return self._flag

    def _count(self, receive: Callable[[], None]) -> None:
        if self._transmits:
            self.errors.transmit_error()
        elif not self._mute:
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
            if (yield RECESSIVE if self._mute else DOMINANT) and not self._mute:
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
        """What is left of a delimiter after its first bit."""
        for left in range(DELIMITER_BITS - 1, 0, -1):
            if not (yield RECESSIVE):
                return self._overload if left == 1 else self._error()
        return self._intermission
