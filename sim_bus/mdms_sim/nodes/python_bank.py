"""Cells as Python objects, with one compiled control tick for all of them."""

from collections.abc import Container, Sequence
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from mdms_cell import speed_loop
from mdms_cell.cell import Cell
from mdms_protocol.frame import Frame
from mdms_sim.nodes.acceptance import identifiers
from mdms_sim.nodes.virtual_board import VirtualBoard

# Only the inner function is cached: a cache does not see that a function it calls has changed.
_step = numba.njit("void(int32[::1])", cache=True)(speed_loop.step)


@numba.njit("void(int32[:, ::1])")
def _step_all(registers: Any) -> None:
    for cell in range(registers.shape[0]):
        _step(registers[cell])


class PythonBank:
    """One `mdms_cell.cell.Cell` a cell; the registers of all are the rows of one matrix."""

    def __init__(self, node_ids: Sequence[int]) -> None:
        self._now_ms = 0
        self._node_ids = tuple(node_ids)
        self._registers = np.zeros((len(node_ids), speed_loop.REGISTERS), np.int32)
        self._boards = [VirtualBoard(memoryview(row)) for row in self._registers]
        self._cells = [
            Cell(board, node_id) for board, node_id in zip(self._boards, node_ids, strict=True)
        ]
        self._counts = self._registers[:, speed_loop.COUNT :: speed_loop.AXIS]
        self._voltages = self._registers[:, speed_loop.VOLTAGE :: speed_loop.AXIS]

    def accepts(self, cell: int) -> Container[int]:
        """See `CellBank`."""
        return identifiers(self._node_ids[cell])

    def deliver(self, cell: int, frame: Frame) -> None:
        """See `CellBank`."""
        self._cells[cell].on_frame(frame.can_id, frame.data)

    def collect(self, cell: int) -> list[Frame]:
        """See `CellBank`."""
        board = self._boards[cell]
        frames = [Frame(*frame) for frame in board.frames]
        board.frames.clear()
        return frames

    def tick(self, counts: NDArray[np.int32], presence: NDArray[np.uint8]) -> NDArray[np.int32]:
        """See `CellBank`."""
        self._counts[:] = counts
        _step_all(self._registers)
        voltages_uv: NDArray[np.int32] = self._voltages.copy()
        for cell, (board, bits) in enumerate(zip(self._boards, presence.tolist(), strict=True)):
            board.presence_bits = bits
            board.cut = False
            self._cells[cell].poll(self._now_ms)
            if board.cut:
                voltages_uv[cell] = 0
        self._now_ms += 1
        return voltages_uv

    def close(self) -> None:
        """See `CellBank`."""
