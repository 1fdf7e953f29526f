"""How clients write frames: packets for python-can, lines of a serial adapter for all else."""

import re
from collections.abc import Callable
from typing import Protocol

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.wire import ERROR, EXTENDED, EXTENDED_MASK, STANDARD_MASK
from mdms_sim.serve import packet
from mdms_sim.serve.slcan import Slcan

_LINES = re.compile(rb"[^\r]*\r|[^\r]+")


class GoneError(Exception):
    """The client has left, or was not one."""


class Codec(Protocol):
    """How a client writes frames; it begins with the greeting."""

    greeting: bytes

    @property
    def garbage(self) -> int:
        """Lines or packets that made no sense."""

    def encode(self, frame: Frame, sim_ns: int) -> bytes:
        """What to send the client of a frame on the bus; may be nothing."""

    def feed(self, data: bytes) -> bytes:
        """Take in what the client wrote, hand its frames over; return what to answer.

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

    greeting = packet.HELLO

    def __init__(self, send: Callable[[Frame], bool], packets: Packets) -> None:
        self.garbage = 0
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


class SlcanCodec:
    """The lines of a serial adapter."""

    greeting = b""

    def __init__(self, send: Callable[[Frame], bool]) -> None:
        self._adapter = Slcan(send)

    @property
    def garbage(self) -> int:
        """Lines refused so far."""
        return self._adapter.garbage

    def encode(self, frame: Frame, sim_ns: int) -> bytes:
        """See `Codec`."""
        return self._adapter.line(frame, sim_ns)

    def feed(self, data: bytes) -> bytes:
        """See `Codec`."""
        return self._adapter.feed(data)


class StrictSlcanCodec(SlcanCodec):
    """The same over TCP, where there is no noise on a line: who sends anything else is no client.

    Any web page may have a browser send here; nothing after its first line has an effect.
    """

    def feed(self, data: bytes) -> bytes:
        """See `Codec`. Raises GoneError at the first line that is not SLCAN."""
        answers = b""
        for piece in _LINES.findall(data):
            answers += super().feed(piece)
            if not self._adapter.is_slcan:
                raise GoneError("what it sends is no SLCAN")
        return answers


def _is_identifier(can_id: int) -> bool:
    largest = EXTENDED_MASK if can_id & EXTENDED else STANDARD_MASK
    return can_id & EXTENDED_MASK <= largest
