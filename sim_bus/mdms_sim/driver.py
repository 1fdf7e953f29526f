"""How the simulation drives the participants on the bus besides the cells."""

from collections.abc import Iterable, Sequence
from functools import partial
from math import ceil, isinf

from mdms_model.participant import BusesParticipant, Participant
from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.bus import Bus
from mdms_sim.bus.controller import Listener
from mdms_sim.kernel import Kernel

NS_PER_S = 1_000_000_000
#: A participant is not polled more often than this.
POLL_NS = 100_000
#: After the world has moved and the cells have answered at that instant.
PRIORITY_POLL = 30


class ParticipantDriver:
    """Puts a participant on its buses and polls it when it wants to be polled.

    A `BusesParticipant` is on all of them, any other on the first. A participant that has left is
    not polled and receives nothing, and its pending frames are lost.
    """

    def __init__(
        self, kernel: Kernel, buses: Sequence[Bus], participant: Participant | BusesParticipant
    ) -> None:
        self._kernel = kernel
        if not isinstance(participant, BusesParticipant):
            participant, buses = _OnFirstBus(participant), buses[:1]
        self._participant = participant
        self._buses = buses
        self._mailboxes = [
            bus.attach(Listener(partial(self.on_frame, number))) for number, bus in enumerate(buses)
        ]
        #: How often it has left each bus without coming back.
        self._left = [0] * len(buses)
        self._due_ns: int | None = None
        self._earliest_ns = 0
        self._wake_s = participant.wake_s
        self._schedule(self._wake_s)

    def leave(self, bus: int | None = None) -> None:
        """Takes the participant off a bus, or all, until it has rejoined as often as it has left.

        A participant on no bus is not polled any more.
        """
        for number in self._numbers(bus):
            self._left[number] += 1
            self._buses[number].switch_off(self._mailboxes[number])

    def rejoin(self, bus: int | None = None) -> None:
        """Puts it back, as late as it is: it is polled at once for overdue frames."""
        for number in self._numbers(bus):
            self._left[number] -= 1
            if not self._left[number]:
                self._buses[number].switch_on(self._mailboxes[number])
                self._schedule(self._participant.wake_s)

    def _numbers(self, bus: int | None) -> Iterable[int]:
        """The buses that are meant, of those that it is on."""
        everywhere = range(len(self._buses))
        return everywhere if bus is None else [number for number in everywhere if number == bus]

    def on_frame(self, bus: int, frame: Frame, now_ns: int) -> None:
        """A frame was on a bus, numbered from 0."""
        participant = self._participant
        participant.on_frame(frame, now_ns / NS_PER_S, bus)
        wake_s = participant.wake_s
        if wake_s != self._wake_s:
            self._schedule(wake_s)

    def _schedule(self, wake_s: float) -> None:
        self._wake_s = wake_s
        if isinf(wake_s):
            return
        wake_ns = max(ceil(wake_s * NS_PER_S), self._kernel.now_ns, self._earliest_ns)
        if self._due_ns is None or wake_ns < self._due_ns:
            self._due_ns = wake_ns
            self._kernel.at(wake_ns, PRIORITY_POLL, partial(self._poll, wake_ns))

    def _poll(self, due_ns: int) -> None:
        if due_ns != self._due_ns:
            return
        if all(self._left):
            self._due_ns = None
            return
        for bus, frame in self._participant.poll_buses(due_ns / NS_PER_S):
            if not self._left[bus]:
                self._mailboxes[bus].send(frame)
        self._due_ns = None
        self._earliest_ns = due_ns + POLL_NS
        self._schedule(self._participant.wake_s)


class _OnFirstBus:
    """A participant that has no word for buses, on the first."""

    def __init__(self, participant: Participant) -> None:
        self._participant = participant

    @property
    def wake_s(self) -> float:
        return self._participant.wake_s

    def on_frame(self, frame: Frame, now_s: float, bus: int = 0) -> None:
        self._participant.on_frame(frame, now_s)

    def poll_buses(self, now_s: float) -> Iterable[tuple[int, Frame]]:
        return [(0, frame) for frame in self._participant.poll(now_s)]
