"""Incoming frames of each bus, by their identifiers: for cells and for other receivers."""

from functools import partial

from mdms_host.can_link.remote_cell import Handler
from mdms_host.coordination.bring_up import BringUpCell
from mdms_host.coordination.commands import CellsControl, Commands
from mdms_host.coordination.recovery import ArrayState
from mdms_host.estimation.tracker import Tracker
from mdms_protocol import pdo
from mdms_protocol.codecs import cob, nmt, sdo
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.emergencies import error_text

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
        by_cells: CellsControl | None,
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
            self._register(cell, by_cells)
        for handlers in self._handlers:
            # Two hosts that began at the same instant meet here.
            handlers[cob.HEARTBEAT_BASE + cob.HOST_NODE] = self._on_other_host
            handlers[cob.NMT] = self._on_other_command

    def on_frame(self, frame: Frame, now_s: float, bus: int) -> None:
        """A frame was on a bus."""
        handler = self._handlers[bus].get(frame.can_id)
        if handler is not None:
            handler(frame.data, now_s)

    def _register(self, cell: BringUpCell, by_cells: CellsControl | None) -> None:
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
        if by_cells is not None:
            handlers[cob.ESTIMATE_BASE + node_id] = partial(by_cells.on_estimate, cell)
            handlers[cob.PROGRAM_BASE + node_id] = partial(by_cells.on_page, cell)

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
