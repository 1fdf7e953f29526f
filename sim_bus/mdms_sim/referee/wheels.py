"""The rules about voltages at wheels: asked, heeded, silent, quiet."""

from collections.abc import Container, Set

from mdms_model.scenario.fault import Fault
from mdms_protocol.codecs.frame import Frame
from mdms_sim.physics.plane.control_step import Registers
from mdms_sim.referee.truth import Note, Truth


class Wheels:
    """Judges what the wheels of all cells get, by what has reached the cells.

    `delivered` are the identifiers of frames to cells that it wants to see.
    """

    def __init__(self, truth: Truth, note: Note) -> None:
        self.delivered: Container[int] = frozenset()

    def watched(self, bus: int) -> Set[int]:
        """The identifiers that it wants to see on a bus, from 0."""
        return frozenset()

    def on_frame(self, bus: int, frame: Frame, now_ns: int) -> None:
        """A watched frame has got through on a bus."""

    def on_delivery(self, cell: int, frame: Frame, now_ns: int) -> None:
        """A frame of another node has reached a cell, from 0."""

    def on_fault(self, fault: Fault, begins: bool, now_ns: int) -> None:
        """A fault begins or ends."""

    def on_tick(self, now_ns: int, voltage_uv: Registers) -> None:
        """The cells hold these voltages (cells, 2), by their places."""
