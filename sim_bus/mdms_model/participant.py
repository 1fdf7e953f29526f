"""Participants on a bus: they decide by frames and time, simulated or real."""

from collections.abc import Iterable
from typing import Protocol, runtime_checkable

from mdms_protocol.codecs.frame import Frame


class Participant(Protocol):
    """Anything on the bus that is not a cell: a coordinator, a commissioning tool."""

    @property
    def wake_s(self) -> float:
        """When it wants to be polled next, if nothing comes in before [s]; inf for never."""
        ...

    def on_frame(self, frame: Frame, now_s: float) -> object:
        """A frame was on the bus."""
        ...

    def poll(self, now_s: float) -> Iterable[Frame]:
        """The frames to send now."""
        ...


@runtime_checkable
class BusesParticipant(Protocol):
    """The same on several buses, numbered from 0; where there is only one it is a `Participant`."""

    @property
    def wake_s(self) -> float:
        """When it wants to be polled next, if nothing comes in before [s]; inf for never."""
        ...

    def on_frame(self, frame: Frame, now_s: float, bus: int = 0) -> object:
        """A frame was on that bus."""
        ...

    def poll_buses(self, now_s: float) -> Iterable[tuple[int, Frame]]:
        """The frames to send now, each with its bus."""
        ...
