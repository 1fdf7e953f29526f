"""Drives a participant over a link in real time, as the simulation kernel does in virtual time."""

from collections.abc import Callable, Iterable
from typing import Protocol

from mdms_host.clock import Clock
from mdms_host.link import Link
from mdms_protocol.frame import Frame


class Participant(Protocol):
    """Anything on the bus; see 'Participant' in DESIGN.md."""

    @property
    def wake_s(self) -> float:
        """When it wants to be polled next, if nothing comes in before [s]."""
        ...

    def on_frame(self, frame: Frame, now_s: float) -> None:
        """A frame was on the bus."""
        ...

    def poll(self, now_s: float) -> Iterable[Frame]:
        """What it wants to send now."""
        ...


def drive(participant: Participant, link: Link, clock: Clock, over: Callable[[], bool]) -> None:
    """Bring participant and bus together until it is over. Raises DeviceGoneError.

    `over` is asked after each round, at least ten times a second.
    """
    while not over():
        now_s = clock.now_s()
        if participant.wake_s <= now_s:
            for frame in participant.poll(now_s):
                link.send(frame)
        link.receive(participant.wake_s - clock.now_s(), participant.on_frame)
