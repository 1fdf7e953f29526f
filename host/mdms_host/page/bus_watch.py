"""The state of a table by the frames on its buses:

cells, setpoints, promises, how busy the wires are.
"""

from collections.abc import Callable, Sequence
from enum import IntEnum

import numpy as np

from mdms_host.can_link.remote_cell import RemoteCell
from mdms_host.coordination.run_state import Timing
from mdms_host.layout import Layout
from mdms_model.arrays import Floats
from mdms_model.buses import Addresses, worst_bits
from mdms_model.run.frame_readers import CellReports, References
from mdms_protocol import pdo
from mdms_protocol.codecs import cia402, cob, nmt
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.entry import steps_per_unit

#: Over at least so long [s].
_OVER_S = 0.1


class BusRates:
    """Frames a second by bus and kind (B, K), loads and error frames a second by bus (B,).

    All are 0 before they are known; error frames that nobody counts are NaN.
    """

    def __init__(self, buses: int, kinds: int) -> None:
        self.frames_per_s: Floats = np.zeros((buses, kinds))
        self.loads: Floats = np.zeros(buses)
        self.errors_per_s: Floats = np.zeros(buses)
        self._last: tuple[float, Floats, Floats, Floats] | None = None

    def count(
        self, now_s: float, frames: Sequence[Sequence[int]], busy_s: Floats, errors: Floats
    ) -> None:
        """So many frames were there by now, each bus busy for so long, with so many errors."""
        if self._last is not None and 0.0 <= now_s - self._last[0] < _OVER_S:
            return
        counted = np.array(frames, np.float64)
        if self._last is not None and now_s > self._last[0]:
            before_s, before, before_busy_s, errors_before = self._last
            passed_s = now_s - before_s
            self.frames_per_s = (counted - before) / passed_s
            self.loads = (busy_s - before_busy_s) / passed_s
            self.errors_per_s = (errors - errors_before) / passed_s
        self._last = now_s, counted, busy_s, errors


#: Kinds that frames are counted by, in the order of their numbers.
KINDS = (
    *("sync", "setpoints", "speeds", "states", "beliefs", "programs"),
    *("SDO", "heartbeats", "emergencies", "other"),
)
_BITS = tuple(worst_bits(length) for length in range(9))
UM_PER_M = steps_per_unit(pdo.ACTUAL_VELOCITY.entries[0].unit)
_FAULTS = frozenset((cia402.FAULT, cia402.FAULT_REACTION))


class CellState(IntEnum):
    """The name of a cell's state on the page, by its frames."""

    OFF = 0
    SILENT = 1
    READY = 2
    RUNNING = 3
    FAULT = 4
    SUSPECTED = 5


def kind_of(can_id: int) -> int:
    """The number of the kind that an identifier belongs to."""
    function, node = can_id & ~0x7F, can_id & 0x7F
    if can_id == cob.SYNC:
        name = "sync"
    elif can_id == cob.PROGRAM or function == cob.PROGRAM_BASE:
        name = "programs"
    elif not node:
        name = "other"
    else:
        name = _BY_FUNCTION.get(function, "other")
    return KINDS.index(name)


_BY_FUNCTION = {
    cob.EMCY_BASE: "emergencies",
    cob.TPDO_BASES[0]: "speeds",
    cob.TPDO_BASES[1]: "states",
    cob.ESTIMATE_BASE: "beliefs",
    cob.RPDO_BASES[0]: "setpoints",
    cob.RPDO_BASES[1]: "states",
    cob.SDO_RESPONSE_BASE: "SDO",
    cob.SDO_REQUEST_BASE: "SDO",
    cob.HEARTBEAT_BASE: "heartbeats",
}
_KIND_OF = bytes(kind_of(can_id) for can_id in range(0x800))


class BusWatch:
    """The cells of a layout as their frames reported them last, and counts of all frames.

    `frames` counts by bus and kind, `bits` by bus, each frame taken to be as long as it can get.
    `references_m_s` are the setpoints sent last, of shape (W,).
    """

    def __init__(self, layout: Layout, silence_s: float | None = None) -> None:
        addresses = Addresses(layout.buses, layout.node_ids)
        self._axes = len(layout.wheels)
        self._silence_s = Timing().silence_s if silence_s is None else silence_s
        several = addresses.bus_count > 1
        places = zip(addresses.buses, addresses.node_ids, strict=True)
        self.cells = tuple(
            RemoteCell(number, node_id, bus if several else None)
            for number, (bus, node_id) in enumerate(places, 1)
        )
        self.frames = [[0] * len(KINDS) for _ in range(addresses.bus_count)]
        self.bits = [0] * addresses.bus_count
        self._references = References(addresses, self._axes)
        self._reports = CellReports(layout.cell_positions_m, addresses)
        self._handlers: list[dict[int, Callable[[Frame, float], None]]] = [
            {} for _ in range(addresses.bus_count)
        ]
        for cell in self.cells:
            for can_id, handler in cell.handlers.items():
                self._handlers[cell.bus][can_id] = _of_cell(handler)
        for bus, handlers in enumerate(self._handlers):
            for can_id in self._references.cells[bus]:
                handlers[can_id] = _of_references(self._references, bus)
            for can_id in self._reports.cells[bus]:
                handlers[can_id] = _of_reports(self._reports, bus)

    def on_frame(self, frame: Frame, now_s: float, bus: int = 0) -> None:
        """A frame was on a bus, whoever sent it."""
        can_id, data = frame
        self.frames[bus][_KIND_OF[can_id & cob.IDENTIFIER]] += 1
        self.bits[bus] += _BITS[len(data)]
        handler = self._handlers[bus].get(can_id)
        if handler is not None:
            handler(frame, now_s)

    def speeds_m_s(self, now_s: float) -> Floats:
        """The last reported speeds, shape (W,); NaN for a cell without one, or a silent one.

        The present action of a silent cell is not known.
        """
        speeds = np.full((len(self.cells), self._axes), np.nan)
        for cell, row in zip(self.cells, speeds, strict=True):
            if cell.speeds_data is not None and self._speaks(cell, now_s):
                row[:] = np.frombuffer(cell.speeds_data, "<i4")[: self._axes]
        return speeds.ravel() / UM_PER_M

    @property
    def references_m_s(self) -> Floats:
        """The setpoints that were sent last, shape (W,)."""
        return self._references.reference_m_s

    def presence(self, now_s: float) -> bytes:
        """The presence bits of all cells, 0 where one has not reported, or is silent."""
        return bytes(cell.presence or 0 if self._speaks(cell, now_s) else 0 for cell in self.cells)

    def promises(self, now_s: float) -> tuple[Floats, Floats]:
        """Of cells that steer: the identity each is at, and how (near, promised, under), (C,)."""
        sample = self._reports.sample(now_s)
        return sample["identity"], sample["state"]

    def states(self, now_s: float) -> bytes:
        """The state of each cell, as `CellState` numbers them."""
        suspected = {(cell.bus, cell.suspect) for cell in self.cells if cell.suspect}
        return bytes(self._state(cell, now_s, suspected) for cell in self.cells)

    def _speaks(self, cell: RemoteCell, now_s: float) -> bool:
        heard_s = cell.last_heartbeat_s
        return heard_s is not None and now_s - heard_s <= self._silence_s

    def _state(self, cell: RemoteCell, now_s: float, suspected: set[tuple[int, int]]) -> int:
        if cell.last_heartbeat_s is None:
            return CellState.OFF
        if not self._speaks(cell, now_s):
            return CellState.SILENT
        states = (cell.drive_states or ())[: self._axes]
        if not _FAULTS.isdisjoint(states):
            return CellState.FAULT
        if (cell.bus, cell.node_id) in suspected:
            return CellState.SUSPECTED
        running = cell.nmt_state == nmt.OPERATIONAL and cia402.OPERATION_ENABLED in states
        return CellState.RUNNING if running else CellState.READY


def _of_cell(handler: Callable[[bytes, float], None]) -> Callable[[Frame, float], None]:
    return lambda frame, now_s: handler(frame.data, now_s)


def _of_references(references: References, bus: int) -> Callable[[Frame, float], None]:
    return lambda frame, now_s: references.on_frame(bus, frame, round(now_s * 1e9))


def _of_reports(reports: CellReports, bus: int) -> Callable[[Frame, float], None]:
    return lambda frame, now_s: reports.on_frame(bus, frame, now_s)
