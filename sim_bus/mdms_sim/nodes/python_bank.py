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

#: From here on, in ticks, due times may wrap, and every cell is asked.
FULL_POLLS_FROM = 1 << 29

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
        self._currents = self._registers[
            :, speed_loop.CURRENT : 2 * speed_loop.AXIS : speed_loop.AXIS
        ]
        self._voltages = self._registers[
            :, speed_loop.VOLTAGE : 2 * speed_loop.AXIS : speed_loop.AXIS
        ]
        self._voltages_uv = np.zeros((len(node_ids), 2), np.int32)
        #: The time of a tick in which some cells were not polled, for they do not know it.
        self._slept_ms: int | None = None
        self._presence: list[int] = []
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
            target = self._cells[cell]
            if self._slept_ms is not None:
                target.now_ms = self._slept_ms
            target.on_frame(frame.can_id, frame.data)
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

    def tick(
        self,
        counts: NDArray[np.int32],
        currents_ma: NDArray[np.int32],
        presence: NDArray[np.uint8],
    ) -> NDArray[np.int32]:
        """See `CellBank`."""
        conditions = self._conditions
        halted = list(conditions.halted)
        kept = self._registers[halted] if halted else None
        self._counts[:] = counts
        self._currents[:] = currents_ma
        _step_all(self._registers)
        self._voltages_uv[:] = self._voltages
        if kept is not None:
            self._registers[halted] = kept
            for cell, frozen_uv in conditions.halted.items():
                self._voltages_uv[cell] = frozen_uv
        if conditions.plain and conditions.ticks < FULL_POLLS_FROM:
            self._poll_awake(conditions.ticks, presence.tolist())
        else:
            self._poll(presence.tolist())
        conditions.ticks += 1
        return self._voltages_uv.copy()

    def _poll_awake(self, now_ms: int, presence: list[int]) -> None:
        """What `_poll` does, without the calls that would do nothing."""
        changed = presence != self._presence
        self._presence = presence
        self._slept_ms = now_ms
        for number, cell in enumerate(self._cells):
            if changed or cell.wake_ms <= now_ms:
                self._poll_one(number, now_ms, presence[number])

    def _poll(self, presence: list[int]) -> None:
        self._slept_ms = None
        halted = self._conditions.halted
        times_ms = self._conditions.times_ms()
        for number, bits in enumerate(presence):
            if number not in halted:
                self._poll_one(number, times_ms[number], bits)

    def _poll_one(self, number: int, now_ms: int, presence: int) -> None:
        board = self._boards[number]
        board.presence_bits = presence
        board.cut = False
        self._cells[number].poll(now_ms)
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
