"""A station's CAN controller: transmit queue and mailboxes, acceptance, receive FIFO.

Three mailboxes and a receive FIFO of three, as in the bxCAN of an STM32F405.
"""

from collections import deque
from collections.abc import Callable, Container
from functools import partial
from heapq import heapify
from typing import TYPE_CHECKING, Protocol

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.confinement import Confinement, ErrorState

if TYPE_CHECKING:
    from mdms_sim.bus.segment import Segment

MAILBOXES = 3
RECEIVE_FIFO = 3
#: Frames that a node keeps in memory for the time when a mailbox is free.
TRANSMIT_QUEUE = 4096


class Station(Protocol):
    """What listens behind a controller."""

    def on_frame(self, frame: Frame, now_ns: int) -> object:
        """A frame that passed the filter has ended at `now_ns`."""


class Controller:
    """One node's way to the bus; made by `Bus.attach`.

    `sent`, `overruns` (frames lost because the FIFO was full) and `refused` (because
    the transmit queue was) count frames; `errors` are the node's error counters.
    """

    __slots__ = (
        "_fifo",
        "_identifiers",
        "_queue",
        "accept",
        "delay_ns",
        "errors",
        "listen_only",
        "live",
        "overruns",
        "refused",
        "segment",
        "sent",
        "station",
        "suspended_until_ns",
        "take",
    )

    def __init__(self, segment: "Segment", station: Station, accept: Container[int] | None) -> None:
        self.segment = segment
        self.station = station
        self.accept = accept
        self.live = True
        self.listen_only = False
        self.errors = Confinement()
        self.suspended_until_ns = 0
        self.delay_ns = 0
        self.sent = 0
        self.overruns = 0
        self.refused = 0
        #: Called with every frame that has passed the filter.
        self.take: Callable[[Frame, int], object] = station.on_frame
        self._queue: deque[Frame] = deque()
        self._identifiers: dict[int, Frame] = {}
        self._fifo: deque[Frame] = deque()

    @property
    def pending(self) -> int:
        """Frames that wait to be sent, in mailboxes and before them."""
        return len(self._queue) + len(self._identifiers)

    @property
    def state(self) -> ErrorState:
        """Error active, error passive or bus off."""
        return self.errors.state

    def has_room(self, can_id: int) -> bool:
        """Whether a frame of this identifier would stand in a mailbox at once."""
        taken = self._identifiers
        return not self._queue and len(taken) < MAILBOXES and can_id not in taken

    def send(self, frame: Frame) -> bool:
        """Queues a frame; False, and counted, when there is no room.

        It takes the next free mailbox when the frames before it have done so, but never stands in
        one beside a frame of the same identifier, so that those keep their order. The mailbox with
        the lowest identifier takes part in the arbitration. With a `delay_ns` all that begins
        so much later.
        """
        if self.delay_ns:
            self.segment.later(self.delay_ns, partial(self._queue_frame, frame))
            return True
        return self._queue_frame(frame)

    def _queue_frame(self, frame: Frame) -> bool:
        if self.has_room(frame.can_id):
            self._load(frame)
        elif len(self._queue) < TRANSMIT_QUEUE:
            self._queue.append(frame)
        else:
            self.refused += 1
            return False
        return True

    def _load(self, frame: Frame) -> None:
        self._identifiers[frame.can_id] = frame
        if self.live and not self.listen_only:
            self.segment.request(self, frame)

    def on_sent(self, frame: Frame) -> None:
        """The bus has carried the frame: its mailbox is free for the next."""
        self.sent += 1
        taken, queue = self._identifiers, self._queue
        del taken[frame.can_id]
        while queue and len(taken) < MAILBOXES and queue[0].can_id not in taken:
            self._load(queue.popleft())

    def request_again(self) -> None:
        """Asks for the bus with every mailbox, after a time without one."""
        for frame in self._identifiers.values():
            self.segment.request(self, frame)

    def drop_queue(self) -> None:
        """Empties queue, mailboxes and FIFO, as a reset does; the bus is to be informed before."""
        self._queue.clear()
        self._identifiers.clear()
        self._fifo.clear()
        self.take = self.station.on_frame

    def hold(self) -> None:
        """The node takes no frames from its FIFO until `release`; what does not fit is lost."""
        self.take = self._keep

    def _keep(self, frame: Frame, now_ns: int) -> None:
        if len(self._fifo) < RECEIVE_FIFO:
            self._fifo.append(frame)
        else:
            self.overruns += 1

    def release(self, now_ns: int) -> None:
        """The node takes frames again, first those that wait."""
        self.take = self.station.on_frame
        while self._fifo:
            self.take(self._fifo.popleft(), now_ns)


Request = tuple[int, int, Controller, Frame]


class Requests(list[Request]):
    """A heap of (arbitration field, number, controller, frame); numbers order equals.

    Frames are pushed and popped with `heapq`.
    """

    def drop(self, controller: Controller, frame: Frame | None = None) -> None:
        """Drops what a controller wants to send, or that frame of it."""
        kept = [each for each in self if each[2] is not controller or frame not in (None, each[3])]
        if len(kept) < len(self):
            self[:] = kept
            heapify(self)

    def contenders(self, now_ns: int) -> list[tuple[Controller, Frame]]:
        """The lowest of each controller that need not let others go first, lowest first."""
        first: dict[Controller, Frame] = {}
        for _, _, controller, frame in sorted(self):
            if controller.suspended_until_ns <= now_ns:
                first.setdefault(controller, frame)
        return list(first.items())
