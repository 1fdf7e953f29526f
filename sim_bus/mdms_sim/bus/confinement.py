"""Fault confinement: the error counters of a node and what they make of it (ISO 11898-1, 12.1)."""

from enum import Enum

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
        """What the counters make of the node."""
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
