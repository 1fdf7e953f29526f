"""A station's CAN controller: queue and mailboxes, acceptance, receive FIFO, confinement.

Three mailboxes and a receive FIFO of three, as in the bxCAN of an STM32F405. Error counters make a
node passive, then bus off (ISO 11898-1, 12.1). A node that is bus off must see 128 times eleven
recessive bits before it comes back.
"""

from collections import deque
from collections.abc import Callable, Container, Iterable, Sequence
from enum import Enum
from functools import partial
from heapq import heapify
from typing import TYPE_CHECKING, Protocol

from mdms_protocol.codecs.frame import Frame
from mdms_sim.kernel import Kernel

if TYPE_CHECKING:
    from mdms_sim.bus.segment import Segment

PASSIVE_LIMIT = 128
BUS_OFF_LIMIT = 256
#: Where a successful reception puts a receive counter that was beyond the passive limit.
RECEIVE_AFTER_SUCCESS = 119
TRANSMIT_ERROR = 8
RECEIVE_ERROR = 1
#: For a receiver whose error flag was answered by others: the fault was likely its own.
RECEIVE_SEVERE_ERROR = 8


class ErrorState(Enum):
    """How far a node is trusted."""

    ACTIVE = "error active"
    PASSIVE = "error passive"
    BUS_OFF = "bus off"


class Confinement:
    """Transmit and receive error counter of one node."""

    __slots__ = ("receive", "transmit")

    def __init__(self) -> None:
        self.transmit = 0
        self.receive = 0

    @property
    def state(self) -> ErrorState:
        """The state of the node by its counters."""
        if self.transmit >= BUS_OFF_LIMIT:
            return ErrorState.BUS_OFF
        if max(self.transmit, self.receive) >= PASSIVE_LIMIT:
            return ErrorState.PASSIVE
        return ErrorState.ACTIVE

    @property
    def clean(self) -> bool:
        """Whether both counters are 0."""
        return not (self.transmit or self.receive)

    def transmitted(self) -> None:
        """A frame of the node was acknowledged."""
        self.transmit = max(0, self.transmit - 1)

    def received(self) -> None:
        """A frame of another node was good."""
        if self.receive >= PASSIVE_LIMIT:
            self.receive = RECEIVE_AFTER_SUCCESS
        else:
            self.receive = max(0, self.receive - 1)

    def transmit_error(self) -> None:
        """A frame of the node was destroyed."""
        self.transmit += TRANSMIT_ERROR

    def receive_error(self) -> None:
        """A frame of another node was bad."""
        self.receive += RECEIVE_ERROR

    def receive_severe_error(self) -> None:
        """An error that a receiver counts against itself: others had none, or its flag failed."""
        self.receive += RECEIVE_SEVERE_ERROR

    def copy(self) -> "Confinement":
        """The same counters, to go on from."""
        other = Confinement()
        other.transmit, other.receive = self.transmit, self.receive
        return other

    def put(self, other: "Confinement") -> None:
        """Takes over the counters of another."""
        self.transmit, self.receive = other.transmit, other.receive

    def reset(self) -> None:
        """The node starts, or has sat out its time off the bus."""
        self.transmit = self.receive = 0


MAILBOXES = 3
RECEIVE_FIFO = 3
#: Frames that a node keeps in memory for the time when a mailbox is free.
TRANSMIT_QUEUE = 4096
#: A board drops frames that the bus has not taken for so long (`WAIT_MS` in `boards/bus.py`).
WAIT_NS = 20_000_000


class Station(Protocol):
    """The listener behind a controller."""

    def on_frame(self, frame: Frame, now_ns: int) -> object:
        """A frame that passed the filter has ended at `now_ns`."""


class Listener:
    """A station that is one function."""

    def __init__(self, on_frame: Callable[[Frame, int], object]) -> None:
        self.on_frame = on_frame


class Controller:
    """One node's way to the bus; made by `Bus.attach`.

    `sent`, `overruns` (frames lost because the FIFO was full) and `refused` (because
    the transmit queue was) count frames; `errors` are the node's error counters.
    """

    __slots__ = (
        "_fifo",
        "_identifiers",
        "_stuck_at",
        "_stuck_ns",
        "accept",
        "delay_ns",
        "delayed",
        "errors",
        "live",
        "overruns",
        "queue",
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
        self.errors = Confinement()
        self.suspended_until_ns = 0
        self.delay_ns = 0
        #: Whether frames have waited for a delay.
        self.delayed = False
        #: Frames in memory that no mailbox is free for.
        self.queue: deque[Frame] = deque()
        self.sent = 0
        self.overruns = 0
        self.refused = 0
        #: Called with every frame that has passed the filter.
        self.take: Callable[[Frame, int], object] = station.on_frame
        #: How many frames were sent when the queue was looked at, and since when.
        self._stuck_at = self._stuck_ns = 0
        self._identifiers: dict[int, Frame] = {}
        self._fifo: deque[Frame] = deque()

    @property
    def pending(self) -> int:
        """Frames that wait to be sent, in mailboxes and before them."""
        return len(self.queue) + len(self._identifiers)

    @property
    def state(self) -> ErrorState:
        """Error active, error passive or bus off."""
        return self.errors.state

    def has_room(self, can_id: int) -> bool:
        """Whether a frame of this identifier would stand in a mailbox at once."""
        taken = self._identifiers
        return not self.queue and len(taken) < MAILBOXES and can_id not in taken

    def send(self, frame: Frame) -> bool:
        """Queues a frame; False, and counted, when there is no room.

        It takes the next free mailbox when the frames before it have done so, but never stands in
        one beside a frame of the same identifier, so that those keep their order. The mailbox with
        the lowest identifier takes part in the arbitration. With a `delay_ns` all that begins
        so much later.
        """
        if self.delay_ns:
            self.delayed = True
            self.segment.later(self.delay_ns, partial(self._queue_frame, frame))
            return True
        return self._queue_frame(frame)

    def _queue_frame(self, frame: Frame) -> bool:
        if self.has_room(frame.can_id):
            self._load(frame)
        elif len(self.queue) < TRANSMIT_QUEUE:
            self.queue.append(frame)
        else:
            self.refused += 1
            return False
        return True

    def _load(self, frame: Frame) -> None:
        self._identifiers[frame.can_id] = frame
        if self.live:
            self.segment.request(self, frame)

    def on_sent(self, frame: Frame) -> None:
        """The bus has carried the frame: its mailbox is free for the next."""
        self.sent += 1
        taken, queue = self._identifiers, self.queue
        del taken[frame.can_id]
        while queue and len(taken) < MAILBOXES and queue[0].can_id not in taken:
            self._load(queue.popleft())

    def drop_late(self, now_ns: int) -> None:
        """Empties the queue if the bus has carried no frame of this node for `WAIT_NS`.

        To be called often while there is a queue, or frames that are `delayed` may make one.
        """
        if not self.queue or self.sent != self._stuck_at:
            self._stuck_at, self._stuck_ns = self.sent, now_ns
        elif now_ns - self._stuck_ns > WAIT_NS:
            self.queue.clear()

    def request_again(self) -> None:
        """Asks for the bus with every mailbox, after a time without one."""
        for frame in self._identifiers.values():
            self.segment.request(self, frame)

    def drop_queue(self) -> None:
        """Empties queue, mailboxes and FIFO, as a reset does; the bus is to be informed before."""
        self.queue.clear()
        self._identifiers.clear()
        self._fifo.clear()
        self.take = self.station.on_frame

    def hold(self) -> None:
        """The node takes no frames from its FIFO until `release`; a full FIFO loses frames."""
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


class SendRequests(list[Request]):
    """A heap of (arbitration field, number, controller, frame); numbers order equals.

    Frames are pushed and popped with `heapq`.
    """

    def drop(self, controller: Controller, frame: Frame | None = None) -> None:
        """Drops all pending frames of a controller, or that frame of it."""
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


#: A flood of identifiers costs time, not memory.
REMEMBERED = 4096

FrameObserver = Callable[[Frame, int], object]
#: An observer and its filter, None for everything.
Observation = tuple[FrameObserver, Container[int] | None]
Recipients = tuple[tuple[FrameObserver, ...], tuple[Controller, ...]]


class Acceptance:
    """A list of identifiers that may change while the node is on the bus; none at first."""

    def __init__(self) -> None:
        self._identifiers: frozenset[int] = frozenset()
        self._changed: Callable[[], object] | None = None

    def __contains__(self, can_id: object) -> bool:
        return can_id in self._identifiers

    def replace(self, identifiers: Iterable[int]) -> None:
        """Lets these identifiers through from now on, and informs the bus."""
        self._identifiers = frozenset(identifiers)
        if self._changed is not None:
            self._changed()

    def on_change(self, changed: Callable[[], object]) -> None:
        """Has `changed` called after every change; for the bus, which keeps who receives what."""
        self._changed = changed


class Receivers(dict[int, Recipients]):
    """Observers and controllers by identifier; `clear` it when any of them has changed."""

    def __init__(
        self, controllers: Sequence[Controller], observations: Sequence[Observation]
    ) -> None:
        super().__init__()
        self._controllers = controllers
        self._observations = observations

    def __missing__(self, can_id: int) -> Recipients:
        if len(self) >= REMEMBERED:
            self.clear()
        observers = tuple(
            observer
            for observer, accept in self._observations
            if accept is None or can_id in accept
        )
        controllers = tuple(
            each
            for each in self._controllers
            if each.live and (each.accept is None or can_id in each.accept)
        )
        self[can_id] = recipients = observers, controllers
        return recipients


SEQUENCES = 128
SEQUENCE_BITS = 11
PRIORITY = 0


class BusOffRecovery:
    """Counts for the nodes of one wire; `done(controller)` is called when one may send again.

    An idle wire gives a sequence every eleven bits; a frame gives one, for it ends in eleven
    recessive bits with its inter-frame space, and so does an error frame.
    """

    def __init__(self, kernel: Kernel, bit_ns: int, done: Callable[[Controller], object]) -> None:
        self._kernel = kernel
        self._sequence_ns = SEQUENCE_BITS * bit_ns
        self._done = done
        self._left: dict[Controller, int] = {}
        self._since_ns: dict[Controller, int] = {}

    def __bool__(self) -> bool:
        return bool(self._left)

    def __contains__(self, controller: Controller) -> bool:
        return controller in self._left

    def start(self, controller: Controller, from_ns: int) -> None:
        """Begins to count for a node; the wire is idle from `from_ns` on."""
        self._left[controller] = SEQUENCES
        self._since_ns[controller] = from_ns
        self._await(controller)

    def drop(self, controller: Controller) -> None:
        """Counts no longer for a node, if it did."""
        self._left.pop(controller, None)

    def on_frame(self, start_ns: int, free_ns: int) -> None:
        """The wire is taken from `start_ns` to `free_ns`."""
        for controller in self._left:
            idle_ns = max(0, start_ns - self._since_ns[controller])
            self._left[controller] -= idle_ns // self._sequence_ns + 1
            self._since_ns[controller] = free_ns
            self._await(controller)

    def postpone(self, free_ns: int) -> None:
        """The frame on the wire ends at another time than was announced."""
        for controller in self._left:
            self._since_ns[controller] = free_ns
            self._await(controller)

    def _await(self, controller: Controller) -> None:
        due_ns = self._since_ns[controller] + max(0, self._left[controller]) * self._sequence_ns
        self._kernel.at(due_ns, PRIORITY, partial(self._check, controller, due_ns))

    def _check(self, controller: Controller, due_ns: int) -> None:
        left = self._left.get(controller)
        if left is None:
            return
        if due_ns == self._since_ns[controller] + max(0, left) * self._sequence_ns:
            del self._left[controller]
            self._done(controller)
