"""What goes wrong on the wire: frames lost, corrupted or held up, and cuts."""

from collections.abc import Mapping, Sequence
from random import Random

from mdms_model.scenario.fault import Fault
from mdms_sim.bus.bus import Bus
from mdms_sim.bus.controller import Controller
from mdms_sim.bus.segment import Segment
from mdms_sim.faults.course import Course, Kind, cells_with
from mdms_sim.faults.frames import (
    Effect,
    FrameFault,
    FrameFaults,
    corrupting,
    losing,
    overloading,
)


class WireFaults:
    """Faults of the wires between the controllers of cells, in their order; `kinds` by name."""

    def __init__(self, buses: Sequence[Bus], controllers: Sequence[Controller]) -> None:
        self._buses = buses
        self._controllers = controllers
        self._at_work = [FrameFaults(bus) for bus in buses]
        self.kinds: Mapping[str, Kind] = {
            "loss": self._loss,
            "corruption": self._corruption,
            "overload": self._overload,
            "cut": self._cut,
        }

    def _nodes(self, cells: Sequence[int]) -> list[Controller] | None:
        """The controllers of cells numbered from 1; None, which is everybody, for no cells."""
        return [self._controllers[cell - 1] for cell in cells] or None

    def _any_on(self, bus: Bus, cells: Sequence[int]) -> bool:
        """Whether any of the cells, numbered from 1, is on a bus; no cells stand for everybody."""
        return not cells or any(self._controllers[cell - 1].segment.bus is bus for cell in cells)

    def _group(self, fault: Fault) -> list[Controller]:
        """The controllers of the cells that have it."""
        return [self._controllers[cell] for cell in cells_with(fault, len(self._controllers))]

    def _loss(self, fault: Fault, random: Random) -> Course:
        return self._striking(fault, random, losing(self._buses, self._nodes(fault.seen_by)))

    def _corruption(self, fault: Fault, random: Random) -> Course:
        return self._striking(fault, random, corrupting(random, self._nodes(fault.seen_by)))

    def _striking(self, fault: Fault, random: Random, effect: Effect) -> Course:
        senders = self._nodes(fault.cells)
        return self._on_frames(fault, FrameFault(senders, fault.probability, random, effect))

    def _overload(self, fault: Fault, random: Random) -> Course:
        effect = overloading(self._group(fault), fault.overload_frames)
        return self._on_frames(fault, FrameFault(None, fault.probability, random, effect))

    def _on_frames(self, fault: Fault, frame_fault: FrameFault) -> Course:
        struck = [
            at_work
            for number, (bus, at_work) in enumerate(zip(self._buses, self._at_work, strict=True))
            if fault.bus in (None, number)
            and self._any_on(bus, fault.cells)
            and self._any_on(bus, fault.seen_by)
        ]

        def begin() -> None:
            for at_work in struck:
                at_work.begin(frame_fault)

        def end() -> str:
            for at_work in struck:
                at_work.end(frame_fault)
            return f"{frame_fault.count} frames"

        return Course(begin, end)

    def _cut(self, fault: Fault, random: Random) -> Course:
        group = self._group(fault)
        pieces: list[Segment] = []

        def begin() -> None:
            for bus in self._buses:
                members = [each for each in group if each.segment.bus is bus]
                if members:
                    pieces.append(bus.cut(members))

        def end() -> None:
            while pieces:
                piece = pieces.pop()
                piece.bus.heal(piece)

        return Course(begin, end)
