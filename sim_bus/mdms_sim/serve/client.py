"""One program on the served bus: a socket or pseudo-terminal, and a controller of its own.

Nothing here waits: what a client does not read in time is dropped and counted, and what the bus
does not take yet is left in the client's socket.
"""

import os
from collections.abc import Callable

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.bus import Bus
from mdms_sim.bus.wire import ERROR
from mdms_sim.serve.codec import Codec, GoneError

#: What is kept for a client that reads slowly [bytes]: some seconds of a full bus.
BACKLOG_BYTES = 1 << 20
#: A client that has this many frames waiting is not read from until the bus has taken some.
PENDING_FRAMES = 64
_READ_BYTES = 1 << 10
#: A client is read no faster than this in simulated time: a bus full of frames without data comes
#: to 510 bytes/ms in packets. A flood of what is no frame, or of commands, costs others no time.
_NS_PER_BYTE = 2_000


class Client:
    """A program on the bus; `dropped` counts frames and answers that it was too slow to read.

    `descriptor` is not blocking. `make_codec(send)` makes the codec for it.
    """

    def __init__(
        self,
        name: str,
        descriptor: int,
        bus: Bus,
        make_codec: "Callable[[Callable[[Frame], bool]], Codec]",
    ) -> None:
        self.name = name
        self.descriptor = descriptor
        self.dropped = 0
        self._deaf = False
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
        """Whether the bus has room for what the client wants to send, and it is not too fast."""
        return self._read_from_ns <= now_ns and self._controller.pending < PENDING_FRAMES

    def on_frame(self, frame: Frame, now_ns: int) -> None:
        """Something was on the bus; see `Station`."""
        if not self._deaf:
            self._keep(self._codec.encode(frame, now_ns))

    def on_error(self, now_ns: int) -> None:
        """An error frame was on the bus."""
        self.on_frame(Frame(ERROR, bytes(8)), now_ns)

    def read(self, now_ns: int) -> None:
        """Take what the client has written. Raises GoneError."""
        try:
            data = os.read(self.descriptor, _READ_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            raise GoneError(str(error)) from error
        if not data:
            raise GoneError("it has closed its end")
        self._read_from_ns = now_ns + len(data) * _NS_PER_BYTE
        self._keep(self._codec.feed(data))

    def write(self) -> None:
        """Give the client what it takes now.

        One that takes no more may have sent frames that are still to be read; `read` sees its end.
        """
        try:
            while self._backlog:
                del self._backlog[: os.write(self.descriptor, self._backlog)]
        except BlockingIOError:
            return
        except OSError:
            self.hear_no_more()

    def hear_no_more(self) -> None:
        """Send the client nothing more; what it has sent still goes out."""
        self._deaf = True
        self._backlog.clear()

    @property
    def has_frames_to_send(self) -> bool:
        """Whether the bus has not taken all yet."""
        return self._controller.pending > 0

    def leave(self) -> None:
        """Take the client off the bus."""
        self.bus.detach(self._controller)

    def _keep(self, text: bytes) -> None:
        if len(self._backlog) + len(text) > BACKLOG_BYTES:
            self.dropped += 1
        else:
            self._backlog += text
