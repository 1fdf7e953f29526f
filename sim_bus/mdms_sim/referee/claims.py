"""The rules about words: 'arrived' is true, and a fault is said."""

from collections.abc import Set

from mdms_model.scenario.fault import Fault
from mdms_protocol.codecs.frame import Frame
from mdms_sim.referee.truth import Note, Truth


class Claims:
    """Judges what the host and the cells say."""

    def __init__(self, truth: Truth, note: Note) -> None:
        self._truth = truth
        self._note = note

    def watched(self, bus: int) -> Set[int]:
        """The identifiers that it wants to see on a bus, from 0."""
        return frozenset()

    def on_frame(self, bus: int, frame: Frame, now_ns: int) -> None:
        """A watched frame has got through on a bus."""

    def on_fault(self, fault: Fault, begins: bool, now_ns: int) -> None:
        """A fault begins or ends."""

    def look(self, now_ns: int) -> None:
        """Look at what is said now."""

    def finish(self, now_ns: int) -> None:
        """The run is over."""
