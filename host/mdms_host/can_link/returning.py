"""A link whose device may go away: it is opened again as soon as it is there.

Until then frames are dropped and nothing comes. Nothing is started again: the run that had the
device has ended by then, and a person or a controller begins the next one.
"""

from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from queue import Empty, SimpleQueue
from threading import Event, Thread
from typing import Any, Protocol, Self

from mdms_host.can_link.delays import Delays
from mdms_host.can_link.link import (
    AnyDelays,
    AnyLink,
    DeviceGoneError,
    Incidents,
    Link,
    LinkCounts,
    LinkError,
    open_bus,
)
from mdms_host.can_link.links import links_of
from mdms_host.clock import Clock, MonotonicClock
from mdms_protocol.codecs.frame import Frame

#: A device is tried again so often [s].
AGAIN_S = 0.5
#: A driver that hangs while it opens the device is left behind after so long [s].
HANGS_S = 5.0
#: While there is no device, the driver looks after everything else this often [s].
_ABSENT_S = 0.01


class OwnLink(AnyLink, Protocol):
    """A link to one bus or several, which is closed when done."""

    def close(self) -> None:
        """Close it."""


#: Opens the device; its incidents go into the list. Raises `LinkError`.
OpenLink = Callable[[list[tuple[float, str]]], OwnLink]


class ReturningLink:
    """A link as `AnyLink` that never raises DeviceGoneError; close it when done.

    `on_gone(text)` is called when the device is gone, and is to end the run. `at_rest` returns
    whether nothing is driven any more; the device is opened again after that. Of several buses
    those that are left bring their cells to rest first. Raises `LinkError` where the device is not
    there at the beginning.
    """

    def __init__(self, open_link: OpenLink, clock: Clock) -> None:
        self.on_gone: Callable[[str], object] = lambda _text: None
        self.at_rest: Callable[[], bool] = lambda: True
        self.incidents: list[tuple[float, str]] = []
        self._open = open_link
        self._clock = clock
        self._before = LinkCounts()
        self._idle = Delays()
        self._link: OwnLink | None = open_link(self.incidents)
        self._is_gone = False
        self._returned: SimpleQueue[OwnLink] = SimpleQueue()
        self._closing = Event()
        self._opener: Thread | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    @property
    def is_there(self) -> bool:
        """Whether the device is open."""
        return self._link is not None and not self._is_gone

    @property
    def counts(self) -> LinkCounts:
        """All counts, those of devices that are gone included."""
        return self._before if self._link is None else self._before + self._link.counts

    @property
    def delays(self) -> AnyDelays:
        """The parts that were held up lately."""
        return self._idle if self._link is None else self._link.delays

    def send(self, frame: Frame) -> None:
        """Send a frame to all cells; dropped while there is no device."""
        self._try(lambda link: link.send(frame))

    def send_polled(self, participant: Any, now_s: float) -> None:
        """Send the frames that a participant has to send now; dropped while there is no device."""
        if self._link is None:
            for _ in participant.poll(now_s):
                pass
        self._try(lambda link: link.send_polled(participant, now_s))

    def receive(self, timeout_s: float, handle: Any) -> None:
        """Hand over the received frames; wait for the first frame at most so long."""
        if self._is_gone and self.at_rest():
            self._begin_to_open()
        if self._link is None:
            self._take_returned()
            self._clock.sleep(min(max(timeout_s, 0.0), _ABSENT_S))
        self._try(lambda link: link.receive(timeout_s, handle))

    def leave_gone(self) -> bool:
        """See `AnyLink`: no error is raised, so there is nothing to leave."""
        return False

    def close(self) -> None:
        """Close the device, and look for none any more."""
        self._closing.set()
        if self._opener is not None:
            self._opener.join(HANGS_S)
        with suppress(Empty):
            self._returned.get_nowait().close()
        if self._link is not None:
            self._link.close()

    def _try(self, do: Callable[[AnyLink], object]) -> None:
        if self._link is None:
            return
        try:
            do(self._link)
        except DeviceGoneError as error:
            others = self._link.leave_gone()
            if not self._is_gone:
                self._is_gone = True
                self.incidents.append((self._clock.now_s(), f"{error}; it is opened again"))
                self.on_gone(str(error))
            if not others:
                self._begin_to_open()

    def _begin_to_open(self) -> None:
        """Close the link, and look for the device in a thread that may wait."""
        gone, self._link = self._link, None
        if gone is None:
            return
        self._is_gone = True
        self._before += gone.counts
        self._opener = Thread(target=self._look_for, args=(gone,), name="CAN opener", daemon=True)
        self._opener.start()

    def _look_for(self, gone: OwnLink) -> None:
        gone.close()
        # An adapter that was not there a moment ago may still be coming up.
        while not self._closing.wait(AGAIN_S):
            try:
                self._returned.put(self._open(self.incidents))
            except LinkError:
                continue
            return

    def _take_returned(self) -> None:
        if not self.at_rest():
            return
        with suppress(Empty):
            self._link = self._returned.get_nowait()
            self._is_gone = False
            text = "the CAN device is there again; nothing moves before it is started"
            self.incidents.append((self._clock.now_s(), text))


@contextmanager
def open_returning(
    options: Namespace, channels: Sequence[str] = ()
) -> Iterator[tuple[ReturningLink, Clock]]:
    """One bus or several, opened again whenever a device has gone and is there again.

    Raises NoBusError where it is not there at the beginning.
    """
    clock = MonotonicClock()

    def open_link(noted: list[tuple[float, str]]) -> OwnLink:
        if not channels:
            return Link(open_bus(options), clock, incidents=Incidents(clock, noted))
        return links_of(options, channels, clock, noted)

    with ReturningLink(open_link, clock) as link:
        yield link, clock
