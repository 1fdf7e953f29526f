"""Cells as Python objects, with one compiled control tick for all of them."""

from collections.abc import Container, Sequence
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from mdms_cell import speed_loop
from mdms_cell.cell import Cell
from mdms_protocol.frame import Frame
from mdms_sim.bus.acceptance import Acceptance
from mdms_sim.nodes.condition import Conditions
from mdms_sim.nodes.virtual_board import VirtualBoard, VirtualFlash, leave_bus, rejoin_bus

# Only the inner function is cached: a cache does not see that a function it calls has changed.
_step = numba.njit("void(int32[::1])", cache=True)(speed_loop.step)


@numba.njit("void(int32[:, ::1])")
def _step_all(registers: Any) -> None:
    for cell in range(registers.shape[0]):
        _step(registers[cell])


class PythonBank:
    """One `mdms_cell.cell.Cell` a cell; the registers of all are the rows of one matrix."""

    def __init__(self, node_ids: Sequence[int]) -> None:
        self._node_ids = list(node_ids)
        self._conditions = Conditions(len(node_ids))
        self._registers = np.zeros((len(node_ids), speed_loop.REGISTERS), np.int32)
        self._flash = [VirtualFlash() for _ in node_ids]
        self._acceptances = [Acceptance() for _ in node_ids]
        self._boards: list[VirtualBoard] = [self._board(cell) for cell in range(len(node_ids))]
        self._cells: list[Cell] = [
            Cell(board, node_id) for board, node_id in zip(self._boards, node_ids, strict=True)
        ]
        self._counts = self._registers[:, speed_loop.COUNT : 2 * speed_loop.AXIS : speed_loop.AXIS]
        self._voltages = self._registers[
            :, speed_loop.VOLTAGE : 2 * speed_loop.AXIS : speed_loop.AXIS
        ]
        self._voltages_uv = np.zeros((len(node_ids), 2), np.int32)
        for cell in range(len(node_ids)):
            self._listen(cell)

    def _board(self, cell: int) -> VirtualBoard:
        return VirtualBoard(memoryview(self._registers[cell]), cell + 1, self._flash[cell])

    def accepts(self, cell: int) -> Container[int]:
        """See `CellBank`."""
        return self._acceptances[cell]

    def deliver(self, cell: int, frame: Frame) -> None:
        """See `CellBank`."""
        if cell not in self._conditions.halted:
            self._cells[cell].on_frame(frame.can_id, frame.data)
            if self._boards[cell].identifiers is not None:
                self._listen(cell)

    def collect(self, cell: int) -> list[Frame]:
        """See `CellBank`."""
        queued = self._boards[cell].frames
        if not queued:
            return []
        frames = [Frame(can_id, data) for can_id, data in queued]
        queued.clear()
        return frames

    def collect_all(self) -> list[tuple[int, list[Frame]]]:
        """See `CellBank`."""
        waiting = [cell for cell, board in enumerate(self._boards) if board.frames]
        return [(cell, self.collect(cell)) for cell in waiting]

    def tick(self, counts: NDArray[np.int32], presence: NDArray[np.uint8]) -> NDArray[np.int32]:
        """See `CellBank`."""
        conditions = self._conditions
        halted = list(conditions.halted)
        kept = self._registers[halted] if halted else None
        self._counts[:] = counts
        _step_all(self._registers)
        self._voltages_uv[:] = self._voltages
        if kept is not None:
            self._registers[halted] = kept
            for cell, frozen_uv in conditions.halted.items():
                self._voltages_uv[cell] = frozen_uv
        self._poll(presence.tolist())
        conditions.ticks += 1
        return self._voltages_uv.copy()

    def _poll(self, presence: list[int]) -> None:
        halted = self._conditions.halted
        times_ms = self._conditions.times_ms()
        for number, (cell, board) in enumerate(zip(self._cells, self._boards, strict=True)):
            if number in halted:
                continue
            board.presence_bits = presence[number]
            board.cut = False
            cell.poll(times_ms[number])
            if board.cut:
                self._voltages_uv[number] = 0
            if board.identifiers is not None:
                self._listen(number)

    def _listen(self, cell: int) -> None:
        board = self._boards[cell]
        if board.identifiers is not None:
            self._acceptances[cell].replace(board.identifiers)
            board.identifiers = None

    def power_off(self, cell: int) -> None:
        """See `CellBank`."""
        self._boards[cell].frames.clear()
        self._conditions.halt(cell, (0, 0))

    def hang(self, cell: int) -> None:
        """See `CellBank`."""
        self._conditions.halt(cell, self._voltages_uv[cell].tolist())

    def restart(self, cell: int, node_id: int | None = None) -> None:
        """See `CellBank`."""
        if node_id is not None:
            self._node_ids[cell] = node_id
        self._conditions.restart(cell)
        self._boards[cell] = self._board(cell)
        self._cells[cell] = Cell(self._boards[cell], self._node_ids[cell])
        self._listen(cell)

    def set_bus_off(self, cell: int, off: bool) -> None:
        """See `CellBank`."""
        if cell not in self._conditions.halted:
            (leave_bus if off else rejoin_bus)(self._cells[cell], self._boards[cell])

    def set_drift(self, cell: int, drift_ppm: int) -> None:
        """See `CellBank`."""
        self._conditions.set_drift(cell, drift_ppm)

    def close(self) -> None:
        """See `CellBank`."""
