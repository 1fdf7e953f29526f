"""Cells as Python objects, with one compiled control tick for all of them."""

from collections.abc import Container, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mdms_cell.cell import Cell
from mdms_cell.drive import speed_loop
from mdms_model.compiled import compiled
from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.controller import Acceptance, Confinement
from mdms_sim.nodes.bank import Conditions
from mdms_sim.nodes.kernels import quicken_cells
from mdms_sim.nodes.virtual_board import (
    SUPPLY_UV,
    VirtualBoard,
    VirtualFlash,
    leave_bus,
    rejoin_bus,
)

#: From here on, in ticks, due times may wrap, and every cell is asked.
FULL_POLLS_FROM = 1 << 29
#: In place of presence bits: of a cell that has something to look after.
STARTLED = -1

_step = compiled(speed_loop.step)


@compiled
def _tick_all(registers: Any, counts: Any, currents_ma: Any, presence: Any, seen: Any) -> bool:
    """Ticks all cells; returns whether any has something to look after, and marks these in `seen`.

    `seen` has the presence bits that each cell has seen, or `STARTLED`.
    """
    startled = False
    for cell in range(registers.shape[0]):
        row = registers[cell]
        for axis in range(speed_loop.AXES):
            base = axis * speed_loop.AXIS
            row[base + speed_loop.COUNT] = counts[cell, axis]
            row[base + speed_loop.CURRENT] = currents_ma[cell, axis]
        _step(row)
        if row[speed_loop.ATTENTION] or presence[cell] != seen[cell]:
            seen[cell] = STARTLED
            startled = True
    return startled


class _Board(VirtualBoard):
    """Sets the filter itself to the identifiers that the cell wants."""

    def __init__(
        self, registers: memoryview, serial: int, settings: VirtualFlash, acceptance: Acceptance
    ) -> None:
        super().__init__(registers, serial, settings)
        self._acceptance = acceptance
        self.errors = Confinement()

    def transmit_errors(self) -> int:
        """The transmit error counter of its controller."""
        return self.errors.transmit

    def receive_errors(self) -> int:
        """The receive error counter of its controller."""
        return self.errors.receive

    def listen(self, identifiers: list[int]) -> None:
        """Let frames with these identifiers through."""
        self._acceptance.replace(identifiers)


class PythonBank:
    """One `mdms_cell.cell.Cell` a cell; the registers of all are the rows of one matrix.

    Cells start with what their `flash` has, which is empty by default.
    """

    def __init__(
        self, node_ids: Sequence[int], flash: Sequence[VirtualFlash] | None = None
    ) -> None:
        quicken_cells()
        self._node_ids = list(node_ids)
        cells = range(len(self._node_ids))
        self._conditions = Conditions(len(cells))
        self._halted = self._conditions.halted
        self._registers = np.zeros((len(cells), speed_loop.REGISTERS), np.int32)
        self._driven_uv = self._registers[
            :, speed_loop.VOLTAGE : speed_loop.AXES * speed_loop.AXIS : speed_loop.AXIS
        ]
        self._voltages_uv = self._driven_uv.copy()
        self._awake = np.zeros(len(cells), np.int32)
        self._supply_uv = np.full(len(cells), SUPPLY_UV, np.int32)
        self._flash = [VirtualFlash() for _ in cells] if flash is None else flash
        self._acceptances = [Acceptance() for _ in cells]
        self._boards = [self._board(cell) for cell in cells]
        self._cells: list[Cell] = [
            Cell(board, node_id) for board, node_id in zip(self._boards, node_ids, strict=True)
        ]
        self._registers[:, speed_loop.SUPPLY] = self._supply_uv
        self._seen = np.full(len(cells), STARTLED, np.int32)
        #: When the first of the cells wants to be polled, if nothing startles it.
        self._wake_ms = 0
        #: The time of a tick in which some cells were not polled, which therefore lack it.
        self._slept_ms: int | None = None

    def _board(self, cell: int) -> _Board:
        registers = memoryview(self._registers[cell])
        return _Board(registers, cell + 1, self._flash[cell], self._acceptances[cell])

    def accepts(self, cell: int) -> Container[int]:
        """See `CellBank`."""
        return self._acceptances[cell]

    def deliver(self, cell: int, frame: Frame) -> None:
        """See `CellBank`."""
        if cell not in self._halted:
            target = self._cells[cell]
            now_ms = target.now_ms if self._slept_ms is None else self._slept_ms
            target.on_frame(frame.can_id, frame.data, now_ms)
            # `min` takes as long as the rest.
            wake_ms = target.wake_ms
            self._wake_ms = wake_ms if wake_ms < self._wake_ms else self._wake_ms

    def collect(self, cell: int) -> list[Frame]:
        """See `CellBank`."""
        board = self._boards[cell]
        frames, board.frames = board.frames, []
        return frames

    def collect_all(self) -> list[tuple[int, list[Frame]]]:
        """See `CellBank`."""
        waiting = [cell for cell, board in enumerate(self._boards) if board.frames]
        return [(cell, self.collect(cell)) for cell in waiting]

    def tick(
        self,
        counts: NDArray[np.int32],
        currents_ma: NDArray[np.int32],
        presence: NDArray[np.uint8],
    ) -> NDArray[np.int32]:
        """See `CellBank`."""
        conditions = self._conditions
        if conditions.plain and conditions.ticks < FULL_POLLS_FROM:
            startled = _tick_all(self._registers, counts, currents_ma, presence, self._seen)
            self._voltages_uv = self._driven_uv.copy()
            self._awake = self._registers[:, speed_loop.AWAKE].copy()
            self._slept_ms = conditions.ticks
            if startled or conditions.ticks >= self._wake_ms:
                self._poll_awake(conditions.ticks, presence)
        else:
            self._slept_ms = None
            self._voltages_uv = self._voltages_uv.copy()
            self._awake = self._awake.copy()
            for turn in conditions.turns():
                self._take_turn(turn, counts, currents_ma, presence)
            for cell, frozen_uv in self._halted.items():
                self._voltages_uv[cell] = frozen_uv
        conditions.ticks += 1
        return self._voltages_uv

    def _take_turn(
        self,
        times_ms: dict[int, int],
        counts: NDArray[np.int32],
        currents_ma: NDArray[np.int32],
        presence: NDArray[np.uint8],
    ) -> None:
        """Ticks and polls some of the cells, by their own clocks."""
        others = [cell for cell in range(len(self._cells)) if cell not in times_ms]
        kept = self._registers[others]
        _tick_all(self._registers, counts, currents_ma, presence, self._seen)
        self._registers[others] = kept
        for cell, time_ms in times_ms.items():
            self._voltages_uv[cell] = self._driven_uv[cell]
            self._awake[cell] = self._registers[cell, speed_loop.AWAKE]
            self._boards[cell].presence_bits = int(presence[cell])
            self._poll(cell, time_ms)

    def _poll_awake(self, now_ms: int, presence: NDArray[np.uint8]) -> None:
        """Polls the cells, without the calls that would do nothing."""
        seen = self._seen.tolist()
        self._seen[:] = presence
        for number, bits in enumerate(presence.tolist()):
            if seen[number] == STARTLED or self._cells[number].wake_ms <= now_ms:
                self._boards[number].presence_bits = bits
                self._poll(number, now_ms)
        self._wake_ms = min(cell.wake_ms for cell in self._cells)

    def _poll(self, cell: int, now_ms: int) -> None:
        self._cells[cell].poll(now_ms)
        if self._boards[cell].restarting:
            self._start(cell)
            self._cells[cell].poll(now_ms)

    @property
    def awake(self) -> NDArray[np.int32]:
        """See `CellBank`."""
        return self._awake

    @property
    def blinking(self) -> NDArray[np.bool_]:
        """See `CellBank`."""
        return np.array([board.blinking for board in self._boards])

    def set_supply(self, cell: int, supply_uv: int) -> None:
        """See `CellBank`."""
        self._supply_uv[cell] = supply_uv
        self._registers[cell, speed_loop.SUPPLY] = supply_uv

    def set_place(self, cell: int, node_id: int) -> None:
        """See `CellBank`."""
        self._boards[cell].place_code = node_id

    def power_off(self, cell: int) -> None:
        """See `CellBank`."""
        self._boards[cell].frames.clear()
        self._boards[cell].blinking = False
        self._awake[cell] = 0
        self._conditions.halt(cell, (0, 0))

    def hang(self, cell: int) -> None:
        """See `CellBank`."""
        self._conditions.halt(cell, self._voltages_uv[cell].tolist())

    def restart(self, cell: int, node_id: int | None = None) -> None:
        """See `CellBank`."""
        if node_id is not None:
            self._node_ids[cell] = node_id
        self._conditions.restart(cell)
        self._start(cell)

    def _start(self, cell: int) -> None:
        before = self._boards[cell]
        self._boards[cell] = self._board(cell)
        self._boards[cell].errors = before.errors
        self._boards[cell].place_code = before.place_code
        self._cells[cell] = Cell(self._boards[cell], self._node_ids[cell])
        self._registers[cell, speed_loop.SUPPLY] = self._supply_uv[cell]
        self._awake[cell] = 0

    def set_bus_off(self, cell: int, off: bool) -> None:
        """See `CellBank`."""
        if cell not in self._conditions.halted:
            (leave_bus if off else rejoin_bus)(self._cells[cell], self._boards[cell])
            if off:
                self._voltages_uv = self._voltages_uv.copy()
                self._voltages_uv[cell] = 0

    def connect(self, cell: int, errors: Confinement) -> None:
        """See `CellBank`."""
        self._boards[cell].errors = errors

    def set_drift(self, cell: int, drift_ppm: int) -> None:
        """See `CellBank`."""
        self._conditions.set_drift(cell, drift_ppm)

    def close(self) -> None:
        """See `CellBank`."""
