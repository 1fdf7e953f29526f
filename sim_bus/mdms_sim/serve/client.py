"""One program on the served bus: a socket or pseudo-terminal, its codec, its controller.

Nothing here waits: frames that a client does not read in time are dropped and counted, and frames
that the bus does not take yet are left in the client's socket. Packets are for python-can, lines of
a serial adapter for all else.
"""

import os
import re
from collections.abc import Callable
from typing import Protocol

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.bus import Bus
from mdms_sim.bus.controller import ErrorState
from mdms_sim.bus.identifier import ERROR, EXTENDED, EXTENDED_MASK, STANDARD_MASK
from mdms_sim.nodes.bank import PRIORITY, RESTART_NS
from mdms_sim.serve import packet
from mdms_sim.serve.slcan import VirtualAdapter

_LINES = re.compile(rb"[^\r]*\r|[^\r]+")


class GoneError(Exception):
    """The client has left, or was not one."""


class Codec(Protocol):
    """How a client writes frames; it begins with the greeting."""

    greeting: bytes

    @property
    def garbage(self) -> int:
        """Lines or packets that made no sense."""

    @property
    def sessions(self) -> int:
        """How many sessions are over whose frames nobody wants any more."""

    def encode(self, frame: Frame, sim_ns: int) -> bytes:
        """The bytes for the client about a frame on the bus; may be empty."""

    def feed(self, data: bytes) -> bytes:
        """Take in the bytes of the client, hand its frames over; return the answer.

        Raises GoneError for a client that is none.
        """


class Packets:
    """The packet of a frame, made once for all clients that receive it."""

    def __init__(self, epoch_s: Callable[[int], float]) -> None:
        self._epoch_s = epoch_s
        self._last: tuple[Frame, int] | None = None
        self._packet = b""

    def __call__(self, frame: Frame, sim_ns: int) -> bytes:
        """The frame with the time of its end."""
        if self._last != (frame, sim_ns):
            self._last = (frame, sim_ns)
            self._packet = packet.pack(frame, self._epoch_s(sim_ns))
        return self._packet


class PacketCodec:
    """The fixed-size packets of the python-can interface, after a greeting from both sides."""

    def __init__(self, send: Callable[[Frame], bool], packets: Packets, bitrate: int) -> None:
        self.greeting = packet.greeting(bitrate)
        self.garbage = 0
        self.sessions = 0
        self._send = send
        self._packets = packets
        self._greeted = False
        self._rest = bytearray()

    def encode(self, frame: Frame, sim_ns: int) -> bytes:
        """See `Codec`."""
        return self._packets(frame, sim_ns)

    def feed(self, data: bytes) -> bytes:
        """See `Codec`. Raises GoneError for a client that does not greet as it should."""
        self._rest += data
        if not self._greeted:
            if not self._rest.startswith(packet.HELLO[: len(self._rest)]):
                raise GoneError("it speaks another version")
            if len(self._rest) < len(packet.HELLO):
                return b""
            del self._rest[: len(packet.HELLO)]
            self._greeted = True
        whole = len(self._rest) // packet.SIZE * packet.SIZE
        for frame, epoch_s in packet.unpack(bytes(self._rest[:whole])):
            if epoch_s is None or frame.can_id & ERROR or not _is_identifier(frame.can_id):
                self.garbage += 1
            else:
                self._send(frame)
        del self._rest[:whole]
        return b""


class StrictAdapter(VirtualAdapter):
    """A serial adapter over TCP, without noise on the line: anything else comes from no client.

    Any web page may have a browser send here; nothing after its first line has an effect.
    """

    def feed(self, data: bytes) -> bytes:
        """See `Codec`. Raises GoneError at the first line that is not SLCAN."""
        answers = b""
        for piece in _LINES.findall(data):
            answers += super().feed(piece)
            if not self.is_slcan:
                raise GoneError("its bytes are no SLCAN")
        return answers


def _is_identifier(can_id: int) -> bool:
    largest = EXTENDED_MASK if can_id & EXTENDED else STANDARD_MASK
    return can_id & EXTENDED_MASK <= largest


#: The buffer of a client that reads slowly [bytes]: some seconds of a full bus.
BACKLOG_BYTES = 1 << 20
#: A client that has this many frames waiting is not read from until the bus has taken some.
PENDING_FRAMES = 64
_READ_BYTES = 1 << 10
#: A client is read no faster than this in simulated time: a bus full of frames without data comes
#: to 510 bytes/ms in packets. A flood of bad bytes, or of commands, costs others no time.
_NS_PER_BYTE = 2_000


class BusClient:
    """A program on the bus; `dropped` counts frames and answers that it was too slow to read.

    `descriptor` is not blocking. `make_codec(send)` makes the codec for it. `forget` drops what has
    been written to it and was not read.
    """

    def __init__(
        self,
        name: str,
        descriptor: int,
        bus: Bus,
        make_codec: "Callable[[Callable[[Frame], bool]], Codec]",
        forget: Callable[[], object] = lambda: None,
    ) -> None:
        self.name = name
        self.descriptor = descriptor
        self.dropped = 0
        self._forget = forget
        self._deaf = False
        self._has_left = False
        self.bus = bus
        self._controller = bus.attach(self)
        self._codec = make_codec(self._controller.send)
        self._backlog = bytearray(self._codec.greeting)
        self._read_from_ns = 0

    @property
    def garbage(self) -> int:
        """Lines or packets that made no sense."""
        return self._codec.garbage

    @property
    def wants_to_write(self) -> bool:
        """Whether something waits until the client reads."""
        return bool(self._backlog)

    def may_read(self, now_ns: int) -> bool:
        """Whether the bus has room for the client's frames, and it is not too fast."""
        return self._read_from_ns <= now_ns and self._controller.pending < PENDING_FRAMES

    def on_frame(self, frame: Frame, now_ns: int) -> None:
        """Something was on the bus; see `Station`."""
        if not self._deaf:
            self._keep(self._codec.encode(frame, now_ns))

    def on_error(self, now_ns: int) -> None:
        """An error frame was on the bus."""
        self.on_frame(Frame(ERROR, bytes(8)), now_ns)

    def read(self, now_ns: int) -> None:
        """Take the bytes of the client. Raises GoneError."""
        try:
            data = os.read(self.descriptor, _READ_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            raise GoneError(str(error)) from error
        if not data:
            raise GoneError("it has closed its end")
        self._read_from_ns = now_ns + len(data) * _NS_PER_BYTE
        sessions = self._codec.sessions
        answers = self._codec.feed(data)
        if self._codec.sessions != sessions:
            # A program that was killed has left its channel open; the next one must not take old
            # frames for new ones.
            self._backlog.clear()
            self._forget()
        self._keep(answers)

    def write(self) -> None:
        """Give the client as many bytes as it takes now.

        A client that takes no more may have sent frames that are still to be read; `read` sees its
        end.
        """
        try:
            while self._backlog:
                del self._backlog[: os.write(self.descriptor, self._backlog)]
        except BlockingIOError:
            return
        except OSError:
            self.hear_no_more()

    def hear_no_more(self) -> None:
        """Send the client nothing more; its own frames still go out."""
        self._deaf = True
        self._backlog.clear()

    @property
    def has_frames_to_send(self) -> bool:
        """Whether the bus has not taken all yet."""
        return self._controller.pending > 0

    def on_bus_off(self, now_ns: int) -> None:
        """Its controller has gone bus off: it loses its frames, and comes back as a cell's does."""
        self._controller.drop_queue()
        self.bus.kernel.at(now_ns + RESTART_NS, PRIORITY, self._recover)

    def _recover(self) -> None:
        if not self._has_left and self._controller.state is ErrorState.BUS_OFF:
            self.bus.recover(self._controller)

    def leave(self) -> None:
        """Take the client off the bus."""
        self._has_left = True
        self.bus.detach(self._controller)

    def _keep(self, text: bytes) -> None:
        if len(self._backlog) + len(text) > BACKLOG_BYTES:
            self.dropped += 1
        else:
            self._backlog += text
