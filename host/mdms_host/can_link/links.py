"""Several buses as one link: the host of a table whose cells are on more than one."""

from argparse import Namespace
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from queue import SimpleQueue
from typing import Self

import can

from mdms_host.can_link.delays import Delays
from mdms_host.can_link.link import (
    QUEUE_WAIT_S,
    AnyLink,
    DeviceGoneError,
    Incidents,
    Link,
    LinkCounts,
    hand_over,
    open_bus,
)
from mdms_host.clock import Clock, MonotonicClock
from mdms_model.participant import BusesParticipant, Participant
from mdms_protocol.codecs.frame import Frame

BusFrame = tuple[int, Frame]
#: Takes a frame, the time [s], and the bus.
Handle = Callable[[Frame, float, int], object]


class Links:
    """A link for each of the buses, numbered from 0; messages call them by their `names`.

    When one device is gone, all is over: a parcel over a border cannot be carried by half. The
    others can be left to bring their cells to rest. Incidents go into `noted`, if it is given.
    """

    def __init__(
        self,
        buses: Sequence[can.BusABC],
        names: Sequence[str],
        clock: Clock,
        noted: list[tuple[float, str]] | None = None,
    ) -> None:
        self.incidents: list[tuple[float, str]] = [] if noted is None else noted
        self._clock = clock
        self._names = names
        self._arrived: SimpleQueue[tuple[Frame, float, int]] = SimpleQueue()
        self._left: set[int] = set()
        self._gone: set[int] = set()
        self._links = []
        for number, (bus, name) in enumerate(zip(buses, names, strict=True)):
            incidents = Incidents(clock, self.incidents, f"{name}: ")
            self._links.append(Link(bus, clock, self._deliver_from(number), incidents))
        self.delays = _JointDelays(names, [link.delays for link in self._links])

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    @property
    def counts(self) -> LinkCounts:
        """The counts of all links together."""
        return sum((link.counts for link in self._links), LinkCounts())

    def send(self, frame: Frame) -> None:
        """Send a frame on every bus. Raises DeviceGoneError."""
        self.send_all((bus, frame) for bus in range(len(self._links)))

    def send_polled(self, participant: BusesParticipant, now_s: float) -> None:
        """Send the frames that a participant has to send now. Raises DeviceGoneError."""
        self.send_all(participant.poll_buses(now_s))

    def send_all(self, frames: Iterable[BusFrame]) -> None:
        """Send the frames of one cycle, which wait for room as long as that together.

        A device that is gone does not keep the others from theirs. Raises DeviceGoneError.
        """
        until_s = self._clock.now_s() + QUEUE_WAIT_S
        gone: DeviceGoneError | None = None
        for bus, frame in frames:
            if bus in self._left:
                continue
            try:
                self._links[bus].send(frame, until_s)
            except DeviceGoneError as error:
                self._gone.add(bus)
                gone = DeviceGoneError(f"{self._names[bus]}: {error}")
        if gone is not None:
            raise gone

    def receive(self, timeout_s: float, handle: Handle) -> None:
        """Hand over the received frames with their bus; wait for the first frame at most so long.

        Raises DeviceGoneError.
        """
        self._check()
        hand_over(self._arrived, timeout_s, handle)

    def close(self) -> None:
        """Close all of them."""
        with ExitStack() as stack:
            for link in self._links:
                stack.callback(link.close)

    def leave_gone(self) -> bool:
        """Go on without the buses whose devices are gone; whether any other is left.

        Frames for them are dropped from now on.
        """
        self._left |= self._gone
        return len(self._left) < len(self._links)

    def _deliver_from(self, bus: int) -> Callable[[Frame, float], object]:
        return lambda frame, now_s: self._arrived.put((frame, now_s, bus))

    def _check(self) -> None:
        for bus, (name, link) in enumerate(zip(self._names, self._links, strict=True)):
            if bus in self._left:
                continue
            try:
                link.check()
            except DeviceGoneError as error:
                self._gone.add(bus)
                raise DeviceGoneError(f"{name}: {error}") from None


class OnEachBus:
    """A participant for each bus as one participant on all of them."""

    def __init__(self, participants: Sequence[Participant]) -> None:
        self._participants = participants

    @property
    def wake_s(self) -> float:
        """When the first of them wants to be polled [s]."""
        return min(each.wake_s for each in self._participants)

    def on_frame(self, frame: Frame, now_s: float, bus: int = 0) -> None:
        """A frame was on that bus."""
        self._participants[bus].on_frame(frame, now_s)

    def poll(self, now_s: float) -> Iterable[Frame]:
        """The frames that the only one has to send now."""
        return self._participants[0].poll(now_s)

    def poll_buses(self, now_s: float) -> Iterable[BusFrame]:
        """The frames of those that are due now."""
        for bus, each in enumerate(self._participants):
            if each.wake_s <= now_s:
                yield from ((bus, frame) for frame in each.poll(now_s))


class _JointDelays:
    """The parts that were held up:

    the cycles of the one program, or the incoming frames of any of the buses.
    """

    def __init__(self, names: Sequence[str], arrivals: Sequence[Delays]) -> None:
        self._cycles = Delays()
        self._arrivals = list(zip(names, arrivals, strict=True))
        #: Cycles count beside each bus: one that takes no frames makes them late.
        self._all = [self._cycles, *arrivals]

    def on_cycle(self, due_s: float, now_s: float) -> None:
        """Something that was due is done now."""
        for delays in self._all:
            delays.on_cycle(due_s, now_s)

    def on_blocked(self, where: str, took_s: float, now_s: float) -> None:
        """The program that a person wrote has just computed for so long."""
        for delays in self._all:
            delays.on_blocked(where, took_s, now_s)

    def reason(self, now_s: float) -> str | None:
        """The parts that were held up in the last second; None if nothing was."""
        own = self._cycles.reason(now_s)
        reasons = ((name, delays.reason(now_s)) for name, delays in self._arrivals)
        of_buses = (f"{name}: {reason}" for name, reason in reasons if reason not in (None, own))
        return next(of_buses, own)

    def slow_reason(self, now_s: float) -> str | None:
        """The evidence of heartbeats alone on the first bus where they come late."""
        reasons = ((name, delays.slow_reason(now_s)) for name, delays in self._arrivals)
        return next((f"{name}: {reason}" for name, reason in reasons if reason), None)


@contextmanager
def open_link(options: Namespace) -> Iterator[tuple[Link, Clock]]:
    """The bus that python-can's options name. Raises NoBusError, DeviceGoneError."""
    clock = MonotonicClock()
    with Link(open_bus(options), clock) as link:
        yield link, clock


@contextmanager
def open_links(options: Namespace, channels: Sequence[str] = ()) -> Iterator[tuple[AnyLink, Clock]]:
    """The bus that the options name, or several that differ in their channels.

    Raises NoBusError, DeviceGoneError.
    """
    if not channels:
        with open_link(options) as (link, clock):
            yield link, clock
        return
    clock = MonotonicClock()
    with links_of(options, channels, clock) as links:
        yield links, clock


def links_of(
    options: Namespace,
    channels: Sequence[str],
    clock: Clock,
    noted: list[tuple[float, str]] | None = None,
) -> Links:
    """Links to several buses that differ in their channels. Raises NoBusError."""
    with ExitStack() as opened:
        buses = []
        for channel in channels:
            bus = open_bus(Namespace(**vars(options) | {"channel": channel}))
            opened.callback(bus.shutdown)
            buses.append(bus)
        # From here on the links close their buses.
        opened.pop_all()
        return Links(buses, channels, clock, noted)
