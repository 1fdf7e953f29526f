"""Cells as real MicroPython processes: the firmware as it runs on a board, but for the board."""

import tempfile
from collections.abc import Container, Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mdms_protocol.frame import Frame
from mdms_sim.bus.acceptance import Acceptance
from mdms_sim.nodes import lockstep
from mdms_sim.nodes.condition import Conditions
from mdms_sim.nodes.micropython_process import MicropythonProcess, stage

#: A process that prints is noticed after so many ticks.
CHECK_TICKS = 100


class MicropythonBank:
    """One process a cell. Raises MicropythonMissing, NodeDied.

    Frames for the cells are kept until an answer is due; then all that have some are asked before
    the first is waited for, so that the processes work at the same time.
    """

    def __init__(self, node_ids: Sequence[int]) -> None:
        self._node_ids = list(node_ids)
        self._conditions = Conditions(len(node_ids))
        self._inbox = [bytearray() for _ in node_ids]
        self._outbox: list[list[Frame]] = [[] for _ in node_ids]
        self._acceptances = [Acceptance() for _ in node_ids]
        self._voltages_uv = np.zeros((len(node_ids), 2), np.int32)
        self._staging = tempfile.TemporaryDirectory(prefix="mdms-")
        self._processes: list[MicropythonProcess] = []
        try:
            self._start()
        except BaseException:
            self.close()
            raise

    def _start(self) -> None:
        folder = Path(self._staging.name)
        stage(folder)
        for serial, node_id in enumerate(self._node_ids, 1):
            self._processes.append(MicropythonProcess(node_id, serial, folder))
        self._exchange(range(len(self._node_ids)))

    def accepts(self, cell: int) -> Container[int]:
        """See `CellBank`."""
        return self._acceptances[cell]

    def deliver(self, cell: int, frame: Frame) -> None:
        """See `CellBank`."""
        if cell in self._conditions.halted:
            return
        self._inbox[cell] += lockstep.pack_frame(frame)
        if len(self._inbox[cell]) > lockstep.FRAMES_MAX - lockstep.FRAME_MAX:
            self._exchange([cell])

    def collect(self, cell: int) -> list[Frame]:
        """See `CellBank`."""
        if self._inbox[cell]:
            self._deliver_all()
        frames, self._outbox[cell] = self._outbox[cell], []
        return frames

    def collect_all(self) -> list[tuple[int, list[Frame]]]:
        """See `CellBank`."""
        self._deliver_all()
        waiting = [cell for cell, frames in enumerate(self._outbox) if frames]
        return [(cell, self.collect(cell)) for cell in waiting]

    def _deliver_all(self) -> None:
        waiting = [cell for cell, inbox in enumerate(self._inbox) if inbox]
        if waiting:
            self._exchange(waiting)

    def tick(
        self,
        counts: NDArray[np.int32],
        currents_ma: NDArray[np.int32],
        presence: NDArray[np.uint8],
    ) -> NDArray[np.int32]:
        """See `CellBank`."""
        conditions = self._conditions
        self._check()
        halted = conditions.halted
        running = [cell for cell in range(len(self._processes)) if cell not in halted]
        bits, times_ms = presence.tolist(), conditions.times_ms()
        wheels = np.hstack([counts, currents_ma]).tolist()
        pack = lockstep.REQUEST.pack
        for cell in running:
            inbox = self._inbox[cell]
            head = pack(len(inbox), lockstep.TICK, bits[cell], *wheels[cell], times_ms[cell])
            self._processes[cell].ask(head + inbox)
            inbox.clear()
        for cell in running:
            self._take_answer(cell)
        conditions.ticks += 1
        return self._voltages_uv.copy()

    def _check(self) -> None:
        if self._conditions.ticks % CHECK_TICKS == 0:
            for process in self._processes:
                process.check()

    def _exchange(self, cells: Iterable[int], what: int = lockstep.NOTHING, value: int = 0) -> None:
        """Hands over the frames that wait for these cells, and takes what they answer."""
        asked = list(cells)
        for cell in asked:
            inbox = self._inbox[cell]
            head = lockstep.REQUEST.pack(len(inbox), what, 0, value, 0, 0, 0, 0)
            self._processes[cell].ask(head + inbox)
            inbox.clear()
        for cell in asked:
            self._take_answer(cell)

    def _take_answer(self, cell: int) -> None:
        reply = self._processes[cell].answer()
        _, first, second = lockstep.REPLY.unpack_from(reply)
        self._voltages_uv[cell] = first, second
        if len(reply) > lockstep.REPLY.size:
            for frame in lockstep.unpack_frames(reply[lockstep.REPLY.size :]):
                if frame.can_id == lockstep.LISTEN:
                    self._acceptances[cell].replace(lockstep.identifiers(frame.data))
                else:
                    self._outbox[cell].append(frame)

    def power_off(self, cell: int) -> None:
        """See `CellBank`."""
        self._inbox[cell].clear()
        self._outbox[cell].clear()
        self._voltages_uv[cell] = 0
        self._conditions.halt(cell, (0, 0))

    def hang(self, cell: int) -> None:
        """See `CellBank`."""
        if self._inbox[cell]:
            self._exchange([cell])
        self._conditions.halt(cell, self._voltages_uv[cell].tolist())

    def restart(self, cell: int, node_id: int | None = None) -> None:
        """See `CellBank`."""
        if node_id is not None:
            self._node_ids[cell] = node_id
        self._inbox[cell].clear()
        self._outbox[cell].clear()
        self._conditions.restart(cell)
        self._exchange([cell], lockstep.RESTART, self._node_ids[cell])

    def set_bus_off(self, cell: int, off: bool) -> None:
        """See `CellBank`."""
        if cell not in self._conditions.halted:
            if off:
                self._exchange([cell])
                self._outbox[cell].clear()
            self._exchange([cell], lockstep.LEAVE_BUS if off else lockstep.REJOIN_BUS)

    def set_drift(self, cell: int, drift_ppm: int) -> None:
        """See `CellBank`."""
        self._conditions.set_drift(cell, drift_ppm)

    def close(self) -> None:
        """See `CellBank`."""
        for process in self._processes:
            process.close()
        self._processes.clear()
        self._staging.cleanup()
