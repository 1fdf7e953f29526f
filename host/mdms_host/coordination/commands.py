"""The commands that cells need in a phase: to each when it has answered, and repeated."""

from collections.abc import Iterator
from math import inf

from mdms_host.coordination.care.roster import Roster
from mdms_host.coordination.cell_setup.bring_up import BringUpCell
from mdms_host.coordination.cells_control import CellsControl
from mdms_host.coordination.phase import BRING_UP, HELD, STOPPED, UP, Phase
from mdms_host.coordination.schedule import Schedule
from mdms_protocol.codecs.frame import Frame

_ENDING = (Phase.STOPPING, Phase.FAILING)
#: Phases in which a cell needs another command once it has answered.
_LED_ON = (*BRING_UP, *_ENDING)


class Commands:
    """The commands to each cell in the phase of the run; a cell that is out has its own phase.

    Sending to all cells at every answer would crowd setpoints off the bus.
    """

    def __init__(
        self, roster: Roster, schedule: Schedule, period_s: float, by_cells: CellsControl | None
    ) -> None:
        self._roster = roster
        self._schedule = schedule
        self._period_s = period_s
        self._by_cells = by_cells
        self._phase = Phase.WAITING
        self._answered: set[BringUpCell] = set()

    def on_phase(self, phase: Phase, now_s: float) -> None:
        """A phase of the run begins: all cells get their commands at once."""
        self._phase = phase
        self._schedule.set("command", now_s)

    def on_answer(self, cell: BringUpCell, now_s: float) -> None:
        """A cell has answered, and may be ready for its next command."""
        if self._phase_of(cell) in _LED_ON:
            self._answered.add(cell)
            self._schedule.set("answer", now_s)

    def due(self, now_s: float) -> Iterator[tuple[int | None, Frame]]:
        """The commands that are due, each with its bus, None for all buses."""
        self._repeat_as_needed(now_s)
        answered = self._schedule.take("answer", now_s, inf)
        everyone = self._schedule.take("command", now_s, self._period_s)
        if not answered and not everyone:
            return
        for cell in self._roster.cells:
            if everyone or cell in self._answered:
                for frame in cell.commands(self._phase_of(cell), now_s):
                    yield cell.bus, frame
        self._answered.clear()
        if everyone and self._by_cells is not None and self._phase in (*_ENDING, *HELD):
            # Behind a quick stop: wheels are to be braked, and not just switched off.
            for frame in self._by_cells.ends():
                yield None, frame

    def _phase_of(self, cell: BringUpCell) -> Phase:
        """The phase that a cell is in; an end is that of all."""
        return self._roster.phase_of(cell, self._phase) if self._phase in UP else self._phase

    def _repeat_as_needed(self, now_s: float) -> None:
        """While all cells run, and when all are off, none needs anything again."""
        running = self._phase is Phase.RUNNING and not self._roster.out
        settled = running or self._phase in STOPPED
        due_s = self._schedule.next_s("command")
        if settled and due_s > now_s:
            self._schedule.cancel("command")
        elif not settled and due_s == inf:
            self._schedule.set("command", now_s)
