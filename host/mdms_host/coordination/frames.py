"""Frames in and out of a run.

Incoming frames of each bus go by their identifiers to their receivers. Each cell gets the command
that it needs in a phase when it has answered, and commands are repeated. Cells that steer get
their programs.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from math import inf

import numpy as np

from mdms_host.can_link.remote_cell import Handler
from mdms_host.coordination.bring_up import BringUpCell
from mdms_host.coordination.recovery import ArrayState, Roster
from mdms_host.coordination.run_state import BRING_UP, HELD, STOPPED, UP, Phase, Schedule
from mdms_host.estimation.belief import Belief
from mdms_host.estimation.tracker import Tracker
from mdms_host.motion.program import ByCells
from mdms_model.arrays import Floats
from mdms_protocol import pdo
from mdms_protocol.codecs import cob, nmt, sdo
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.emergencies import error_text
from mdms_protocol.neighbours.messages import (
    Lost,
    Page,
    decode_estimate,
    decode_page,
    encode_page,
)


class CellsControl:
    """Between a program for cells that steer and the bus; nothing here sets a wheel's speed."""

    def __init__(self, cells: Sequence[BringUpCell], program: ByCells) -> None:
        self._cells = cells
        self._program = program
        #: The states of all drives, and the references that follow from these.
        self._last: tuple[list[object], Floats] = ([], np.zeros(0))

    @property
    def references_m_s(self) -> Floats:
        """The wheels' references, shape (W,): 0 where a drive is off, NaN where a cell drives."""
        states: list[object] = [cell.drive_states for cell in self._cells]
        if states != self._last[0]:
            driven = np.array([driven for cell in self._cells for driven in cell.driven])
            self._last = states, np.where(driven, np.nan, 0.0)
        return self._last[1]

    def on_estimate(self, cell: BringUpCell, data: bytes, now_s: float) -> None:
        """The third TPDO of a cell; one that cannot be decoded is counted and dropped."""
        estimate = decode_estimate(data)
        if estimate is None:
            cell.garbage += 1
        else:
            self._program.on_estimate(cell.number, estimate, now_s)

    def on_page(self, cell: BringUpCell, data: bytes, _now_s: float) -> None:
        """The fourth TPDO of a cell: an answer, or a page that it hands on to its neighbours."""
        page = decode_page(data)
        if page is None:
            cell.garbage += 1
        elif isinstance(page, Lost):
            self._program.on_answer(cell.number, page)

    def frames(self, beliefs: Mapping[str, Belief], now_s: float, step_s: float) -> Iterator[Frame]:
        """Frames to send in this cycle, given the beliefs."""
        self._program.on_silence({cell.number: cell.silence_s(now_s) for cell in self._cells})
        return map(_frame, self._program.step(beliefs, now_s, step_s))

    def begin_again(self) -> None:
        """All programs have ended, and the parcels lie still: each gets its program anew."""
        self._program.begin_again()

    def ends(self) -> Iterator[Frame]:
        """Frames that end all programs."""
        return map(_frame, self._program.ends())


def _frame(page: Page) -> Frame:
    return Frame(cob.PROGRAM, encode_page(page))


_ENDING = (Phase.STOPPING, Phase.FAILING)
#: Phases in which a cell needs another command once it has answered.
_LED_ON = (*BRING_UP, *_ENDING)


class Commands:
    """The commands to each cell in the phase of the run; a cell that is out has its own phase.

    Sending to all cells at every answer would crowd setpoints off the bus.
    """

    def __init__(
        self, roster: Roster, schedule: Schedule, period_s: float, steering: CellsControl | None
    ) -> None:
        self._roster = roster
        self._schedule = schedule
        self._period_s = period_s
        self._steering = steering
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
        if everyone and self._steering is not None and self._phase in (*_ENDING, *HELD):
            # Behind a quick stop: wheels are to be braked, and not just switched off.
            for frame in self._steering.ends():
                yield None, frame

    def _phase_of(self, cell: BringUpCell) -> Phase:
        """The phase that a cell is in: its own while it is out; an end is that of all."""
        way = self._roster.out.get(cell) if self._phase in UP else None
        return self._phase if way is None else way.phase

    def _repeat_as_needed(self, now_s: float) -> None:
        """While all cells run, and when all are off, none needs anything again."""
        # Cells that steer are told again and again to stand: one may have missed it.
        kept = self._phase is Phase.KEEPING and self._steering is None
        running = (kept or self._phase is Phase.RUNNING) and not self._roster.out
        settled = running or self._phase in STOPPED
        due_s = self._schedule.next_s("command")
        if settled and now_s < due_s < inf:
            self._schedule.cancel("command")
        elif not settled and due_s == inf:
            self._schedule.set("command", now_s)


#: Objects that command a drive, by their indices.
_COMMANDS = {
    entry.index for map_ in (pdo.CONTROLWORD, pdo.TARGET_VELOCITY) for entry in map_.entries
}
#: A reset switches drives off as well, and the cell is the other program's until it is done.
_SWITCHING_OFF = frozenset(nmt.TRANSITIONS) - {nmt.START}


class FrameRouter:
    """Takes in the frames of all buses.

    Frames of other nodes, and frames that cannot be decoded, do nothing. `other_host` is whether
    another node sends heartbeats as the host. `switched_off` is whether another node has taken
    cells out of 'operational'. `commanded` is the first cell whose drives another node has
    commanded, None without one.
    """

    def __init__(
        self,
        array: ArrayState,
        buses: int,
        tracker: Tracker,
        commands: Commands,
        steering: CellsControl | None,
    ) -> None:
        self.other_host = False
        self.switched_off = False
        self.commanded: BringUpCell | None = None
        self._supervision = array.supervision
        self._odometry = array.odometry
        self._journal = array.journal
        self._tracker = tracker
        self._commands = commands
        self._handlers: list[dict[int, Handler]] = [{} for _ in range(buses)]
        for cell in array.roster.cells:
            self._register(cell, steering)
        for handlers in self._handlers:
            # Two hosts that began at the same instant meet here.
            handlers[cob.HEARTBEAT_BASE + cob.HOST_NODE] = self._on_other_host
            handlers[cob.NMT] = self._on_other_command

    def on_frame(self, frame: Frame, now_s: float, bus: int) -> None:
        """A frame was on a bus."""
        handler = self._handlers[bus].get(frame.can_id)
        if handler is not None:
            handler(frame.data, now_s)

    def _register(self, cell: BringUpCell, steering: CellsControl | None) -> None:
        """Take in a cell's frames; others act on some of them as well."""
        handlers, node_id = self._handlers[cell.bus], cell.node_id
        handlers |= cell.handlers
        handlers[cob.HEARTBEAT_BASE + node_id] = partial(self._on_heartbeat, cell)
        handlers[pdo.STATUS.can_id(node_id)] = partial(self._on_status, cell)
        handlers[pdo.ACTUAL_VELOCITY.can_id(node_id)] = partial(self._odometry.on_speeds, cell)
        handlers[cob.EMCY_BASE + node_id] = partial(self._on_emergency, cell)
        handlers[cob.SDO_RESPONSE_BASE + node_id] = partial(self._on_answer, cell)
        for each in (pdo.CONTROLWORD, pdo.TARGET_VELOCITY):
            handlers[each.can_id(node_id)] = partial(self._on_other_values, cell, each)
        handlers[cob.SDO_REQUEST_BASE + node_id] = partial(self._on_other_request, cell)
        if steering is not None:
            handlers[cob.ESTIMATE_BASE + node_id] = partial(steering.on_estimate, cell)
            handlers[cob.PROGRAM_BASE + node_id] = partial(steering.on_page, cell)

    def _on_heartbeat(self, cell: BringUpCell, data: bytes, now_s: float) -> None:
        before = cell.nmt_state
        cell.on_heartbeat(data, now_s)
        if cell.nmt_state != before:
            self._supervision.recheck()
            # The command itself may have gone unheard; no fault of a cell leads there by default.
            self.switched_off |= (before, cell.nmt_state) == (nmt.OPERATIONAL, nmt.STOPPED)

    def _on_status(self, cell: BringUpCell, data: bytes, now_s: float) -> None:
        before, garbage = cell.drive_states, cell.garbage
        cell.on_status(data, now_s)
        if cell.garbage != garbage:
            return
        if cell.drive_states != before:
            self._supervision.recheck()
        if cell.presence is not None:
            self._tracker.on_presence(now_s, cell.number, cell.presence)
        self._commands.on_answer(cell, now_s)

    def _on_emergency(self, cell: BringUpCell, data: bytes, now_s: float) -> None:
        before = set(cell.errors.items())
        cell.on_emergency(data, now_s)
        after = set(cell.errors.items())
        for error in sorted(before - after):
            self._journal.note(now_s, f"{cell.name} clears emergency {error_text(*error)}")
        for error in sorted(after - before):
            self._journal.note(now_s, f"{cell.name} sends emergency {error_text(*error)}")

    def _on_answer(self, cell: BringUpCell, data: bytes, now_s: float) -> None:
        cell.on_answer(data, now_s)
        self._commands.on_answer(cell, now_s)

    def _on_other_host(self, data: bytes, now_s: float) -> None:
        """Somebody else sends heartbeats as the host."""
        self.other_host |= nmt.decode_heartbeat(data) is not None

    def _on_other_values(
        self, cell: BringUpCell, map_: pdo.PdoMap, data: bytes, _now_s: float
    ) -> None:
        """Somebody else sends controlwords or setpoints."""
        if map_.decode(data) is not None:
            self.commanded = self.commanded or cell

    def _on_other_request(self, cell: BringUpCell, data: bytes, _now_s: float) -> None:
        """Somebody else reads or writes an object."""
        writes = len(data) == 8 and data[0] & sdo.SPECIFIER == sdo.DOWNLOAD
        if writes and int.from_bytes(data[1:3], "little") in _COMMANDS:
            self.commanded = self.commanded or cell

    def _on_other_command(self, data: bytes, now_s: float) -> None:
        """Somebody else sends commands of network management."""
        self.switched_off |= len(data) == 2 and data[0] in _SWITCHING_OFF
