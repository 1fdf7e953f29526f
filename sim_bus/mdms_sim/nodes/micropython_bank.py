"""Cells as real MicroPython processes: the firmware as it runs on a board, but for the board."""

import tempfile
from collections.abc import Container, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mdms_protocol.frame import Frame
from mdms_sim.nodes.acceptance import identifiers
from mdms_sim.nodes.lockstep import REPLY, REQUEST, pack_frame, unpack_frames
from mdms_sim.nodes.micropython_process import MicropythonProcess, stage

#: A process that prints is noticed after so many ticks.
CHECK_TICKS = 100


class MicropythonBank:
    """One process a cell. Raises MicropythonMissing, NodeDied.

    Frames for the cells are kept until an answer is due; then all that have some are asked before
    the first is waited for, so that the processes work at the same time.
    """

    def __init__(self, node_ids: Sequence[int]) -> None:
        self._now_ms = 0
        self._node_ids = tuple(node_ids)
        self._inbox = [bytearray() for _ in node_ids]
        self._outbox: list[list[Frame]] = [[] for _ in node_ids]
        self._voltages_uv = np.zeros((len(node_ids), 2), np.int32)
        self._staging = tempfile.TemporaryDirectory(prefix="mdms-")
        self._processes: list[MicropythonProcess] = []
        try:
            stage(Path(self._staging.name))
            for node_id in node_ids:
                self._processes.append(MicropythonProcess(node_id, Path(self._staging.name)))
        except BaseException:
            self.close()
            raise

    def accepts(self, cell: int) -> Container[int]:
        """See `CellBank`."""
        return identifiers(self._node_ids[cell])

    def deliver(self, cell: int, frame: Frame) -> None:
        """See `CellBank`."""
        self._inbox[cell] += pack_frame(frame)

    def collect(self, cell: int) -> list[Frame]:
        """See `CellBank`."""
        if self._inbox[cell]:
            self._exchange_frames()
        frames = self._outbox[cell]
        self._outbox[cell] = []
        return frames

    def tick(self, counts: NDArray[np.int32], presence: NDArray[np.uint8]) -> NDArray[np.int32]:
        """See `CellBank`."""
        if self._now_ms % CHECK_TICKS == 0:
            for process in self._processes:
                process.check()
        rows = zip(self._processes, self._inbox, counts.tolist(), presence.tolist(), strict=True)
        for process, inbox, (first, second), bits in rows:
            head = REQUEST.pack(len(inbox), True, bits, first, second, self._now_ms)
            process.ask(head + inbox)
            inbox.clear()
        for cell in range(len(self._processes)):
            self._take_answer(cell)
        self._now_ms += 1
        return self._voltages_uv.copy()

    def _exchange_frames(self) -> None:
        asked = [cell for cell, inbox in enumerate(self._inbox) if inbox]
        for cell in asked:
            inbox = self._inbox[cell]
            self._processes[cell].ask(REQUEST.pack(len(inbox), False, 0, 0, 0, 0) + inbox)
            inbox.clear()
        for cell in asked:
            self._take_answer(cell)

    def _take_answer(self, cell: int) -> None:
        reply = self._processes[cell].answer()
        _, first, second = REPLY.unpack_from(reply)
        self._voltages_uv[cell] = first, second
        if len(reply) > REPLY.size:
            self._outbox[cell] += unpack_frames(reply[REPLY.size :])

    def close(self) -> None:
        """See `CellBank`."""
        for process in self._processes:
            process.close()
        self._processes.clear()
        self._staging.cleanup()
