"""The rules about parcels: one parcel a cell, and parcels apart."""

from collections.abc import Set

from mdms_model.scenario.fault import Fault
from mdms_protocol.codecs.frame import Frame
from mdms_sim.referee.truth import Note, Truth


class Parcels:
    """Judges where parcels are, and for whom cells drive."""

    def __init__(self, truth: Truth, note: Note) -> None:
        self._world = truth.world
        self._note = note
        self._seen = 0

    def watched(self, bus: int) -> Set[int]:
        """The identifiers that it wants to see on a bus, from 0."""
        return frozenset()

    def on_frame(self, bus: int, frame: Frame, now_ns: int) -> None:
        """A watched frame has got through on a bus."""

    def on_fault(self, fault: Fault, begins: bool, now_ns: int) -> None:
        """A fault begins or ends."""

    def look(self, now_ns: int) -> None:
        """Look at the parcels as they are now."""
        for event in self._world.events[self._seen :]:
            if event.kind in ("touch", "tip"):
                self._note("apart", f"{event.parcel} {event.detail}", parcel=event.parcel)
        self._seen = len(self._world.events)
