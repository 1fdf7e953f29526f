"""A station's CAN controller: transmit queue and mailboxes, acceptance, receive FIFO.

Three mailboxes and a receive FIFO of three, as in the bxCAN of an STM32F405.
"""

from collections import deque
from collections.abc import Container
from typing import TYPE_CHECKING, Protocol

from mdms_protocol.frame import Frame

if TYPE_CHECKING:
    from mdms_sim.bus.bus import Bus

MAILBOXES = 3
RECEIVE_FIFO = 3


class Station(Protocol):
    """What listens behind a controller."""

    def on_frame(self, frame: Frame, now_ns: int) -> object:
        """A frame that passed the filter has ended at `now_ns`."""


class Controller:
    """One node's way to the bus; made by `Bus.attach`."""

    __slots__ = (
        "_bus",
        "_fifo",
        "_identifiers",
        "_queue",
        "accept",
        "held",
        "overruns",
        "received",
        "sent",
        "station",
    )

    def __init__(self, bus: "Bus", station: Station, accept: Container[int] | None) -> None:
        self._bus = bus
        self.station = station
        self.accept = accept
        self.held = False
        self.sent = 0
        self.received = 0
        self.overruns = 0
        self._queue: deque[Frame] = deque()
        self._identifiers: set[int] = set()
        self._fifo: deque[Frame] = deque()

    @property
    def pending(self) -> int:
        """Frames that wait to be sent, in mailboxes and before them."""
        return len(self._queue) + len(self._identifiers)

    def send(self, frame: Frame) -> None:
        """Queues a frame.

        It takes the next free mailbox when the frames before it have done so, but never stands in
        one beside a frame of the same identifier, so that those keep their order. The mailbox with
        the lowest identifier takes part in the arbitration.
        """
        if self._queue or not self._has_room(frame):
            self._queue.append(frame)
        else:
            self._load(frame)

    def _has_room(self, frame: Frame) -> bool:
        taken = self._identifiers
        return len(taken) < MAILBOXES and frame.can_id not in taken

    def _load(self, frame: Frame) -> None:
        self._identifiers.add(frame.can_id)
        self._bus.request(self, frame)

    def on_sent(self, frame: Frame) -> None:
        """The bus has carried the frame: its mailbox is free for the next."""
        self.sent += 1
        self._identifiers.remove(frame.can_id)
        while self._queue and self._has_room(self._queue[0]):
            self._load(self._queue.popleft())

    def on_received(self, frame: Frame, now_ns: int) -> None:
        """A frame has passed the filter: hands it over, or keeps it while the node is `held`."""
        if not self.held:
            self.received += 1
            self.station.on_frame(frame, now_ns)
        elif len(self._fifo) < RECEIVE_FIFO:
            self._fifo.append(frame)
        else:
            self.overruns += 1

    def hold(self) -> None:
        """The node takes no frames from its FIFO until `release`; what does not fit is lost."""
        self.held = True

    def release(self, now_ns: int) -> None:
        """The node takes frames again, first those that wait."""
        self.held = False
        while self._fifo:
            self.on_received(self._fifo.popleft(), now_ns)
