"""Cells as real MicroPython processes: the firmware as it runs on a board, but for the board."""

import struct
from collections.abc import Container, Iterable, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from mdms_protocol.codecs.frame import Frame
from mdms_sim.bus.controller import Acceptance, Confinement
from mdms_sim.nodes import lockstep
from mdms_sim.nodes.bank import Conditions
from mdms_sim.nodes.micropython_process import Blocks, MicropythonProcess, stage
from mdms_sim.nodes.virtual_board import SUPPLY_UV, VirtualFlash

#: A process that prints is noticed after so many ticks.
CHECK_TICKS = 100


class MicropythonBank:
    """One process a cell. Raises MicropythonMissing, NodeDied, OSError.

    Processes work at the same time as each other and as the bus: they get a frame as soon
    as it has reached the cell, and waited for when the result is asked for. Frames
    that nothing can come of before the next tick wait for it.

    Cells start with what their `flash` has, which is empty by default. `flash` follows their own
    within some 1.1 s, and when the bank is closed.
    """

    def __init__(
        self, node_ids: Sequence[int], flash: Sequence[VirtualFlash] | None = None
    ) -> None:
        self._node_ids = list(node_ids)
        self._conditions = Conditions(len(node_ids))
        self._acceptances = [Acceptance() for _ in node_ids]
        #: Identifiers that a cell never answers.
        self._silent: list[Container[int]] = [() for _ in node_ids]
        #: Cells that have been asked and have not answered.
        self._asked: list[int] = []
        #: Frames that nobody has collected yet, of the cells that have some.
        self._outbox: dict[int, list[Frame]] = {}
        #: The addition to the next request.
        self._taken = [0] * len(node_ids)
        self._processes: list[MicropythonProcess] = []
        self._flash = flash
        #: The file of each flash, and when it was written as it is in `flash`.
        self._files: dict[Path, int] = {}
        with ExitStack() as stack:
            self._blocks = stack.enter_context(closing(Blocks(len(node_ids))))
            self._blocks.supply_uv[:] = SUPPLY_UV
            self._start(Path(stack.enter_context(TemporaryDirectory(prefix="mdms-"))), stack)
            self._open = stack.pop_all()

    def _start(self, folder: Path, stack: ExitStack) -> None:
        stage(folder)
        for cell, flash in enumerate(self._flash or ()):
            path = folder / f"flash-{cell}"
            with path.open("wb") as file:
                flash.save(file)
            self._files[path] = path.stat().st_mtime_ns
        # The processes end before, and leave all that is stored.
        stack.callback(self._read_flash)
        files = list(self._files)
        for cell, node_id in enumerate(self._node_ids):
            stored = files[cell] if files else None
            process = MicropythonProcess(cell, node_id, folder, self._blocks, stored)
            self._processes.append(stack.enter_context(closing(process)))
        self._ask(range(len(self._node_ids)), lockstep.NOTHING)
        self._settle()

    def accepts(self, cell: int) -> Container[int]:
        """See `CellBank`."""
        return self._acceptances[cell]

    def deliver(self, cell: int, frame: Frame) -> None:
        """See `CellBank`."""
        if cell in self._conditions.halted:
            return
        if cell in self._asked:
            self._settle()
        room = self._blocks.put(cell, frame.can_id, frame.data)
        if frame.can_id not in self._silent[cell] or not room:
            self._ask([cell], lockstep.NOTHING)

    def collect(self, cell: int) -> list[Frame]:
        """See `CellBank`."""
        self._settle()
        frames = self._outbox.pop(cell, [])
        if frames:
            self._taken[cell] = lockstep.TAKEN
        return frames

    def collect_all(self) -> list[tuple[int, list[Frame]]]:
        """See `CellBank`."""
        self._settle()
        return [(cell, self.collect(cell)) for cell in sorted(self._outbox)]

    def tick(
        self,
        counts: NDArray[np.int32],
        currents_ma: NDArray[np.int32],
        presence: NDArray[np.uint8],
    ) -> NDArray[np.int32]:
        """See `CellBank`."""
        self._settle()
        conditions, blocks = self._conditions, self._blocks
        if conditions.ticks % CHECK_TICKS == 0:
            self._check()
        blocks.counts[:] = counts
        blocks.currents_ma[:] = currents_ma
        blocks.presence[:] = presence
        for turn in conditions.turns():
            blocks.times_ms[list(turn)] = list(turn.values())
            self._ask(turn, lockstep.TICK)
            self._settle()
        conditions.ticks += 1
        return blocks.voltages_uv.copy()

    def _read_flash(self) -> None:
        for (path, read_ns), flash in zip(self._files.items(), self._flash or (), strict=True):
            written_ns = path.stat().st_mtime_ns
            if written_ns != read_ns:
                with path.open("rb") as file:
                    flash.load(file)
                self._files[path] = written_ns

    def _check(self) -> None:
        self._read_flash()
        for process in self._processes:
            process.check()

    def _ask(self, cells: Iterable[int], request: int) -> None:
        """Has the cells begin with a command, all at the same time."""
        for cell in cells:
            self._processes[cell].ask(request | self._taken[cell])
            self._taken[cell] = 0
            self._asked.append(cell)

    def _settle(self) -> None:
        """Waits for all cells that have been asked."""
        for cell in self._asked:
            if self._processes[cell].answer():
                self._hear(cell)
        self._asked.clear()

    def _hear(self, cell: int) -> None:
        frames = []
        for can_id, data in self._blocks.outbox(cell):
            if can_id == lockstep.LISTENS:
                self._acceptances[cell].replace(_identifiers(data))
            elif can_id == lockstep.SILENT:
                self._silent[cell] = frozenset(_identifiers(data))
            else:
                frames.append(Frame(can_id, data))
        if frames:
            self._outbox[cell] = frames

    def _do(self, cell: int, request: int) -> None:
        self._ask([cell], request)
        self._settle()

    @property
    def awake(self) -> NDArray[np.int32]:
        """See `CellBank`."""
        return self._blocks.awake.copy()

    @property
    def blinking(self) -> NDArray[np.bool_]:
        """See `CellBank`."""
        lit: NDArray[np.bool_] = self._blocks.blinking != 0
        return lit

    def set_supply(self, cell: int, supply_uv: int) -> None:
        """See `CellBank`."""
        self._settle()
        self._blocks.supply_uv[cell] = supply_uv

    def set_place(self, cell: int, node_id: int) -> None:
        """See `CellBank`."""
        self._settle()
        self._blocks.places[cell] = node_id

    def power_off(self, cell: int) -> None:
        """See `CellBank`."""
        self._settle()
        self._blocks.awake[cell] = self._blocks.blinking[cell] = 0
        self._forget(cell)
        self._blocks.voltages_uv[cell] = 0
        self._conditions.halt(cell, (0, 0))

    def _forget(self, cell: int) -> None:
        """Frames that were queued will not be sent."""
        self._outbox.pop(cell, None)
        self._blocks.clear(cell)
        self._taken[cell] = lockstep.TAKEN

    def hang(self, cell: int) -> None:
        """See `CellBank`."""
        self._settle()
        self._conditions.halt(cell, self._blocks.voltages_uv[cell].tolist())

    def restart(self, cell: int, node_id: int | None = None) -> None:
        """See `CellBank`."""
        if node_id is not None:
            self._node_ids[cell] = node_id
        self._settle()
        self._forget(cell)
        self._conditions.restart(cell)
        self._blocks.rename(cell, self._node_ids[cell])
        self._do(cell, lockstep.RESTART)

    def set_bus_off(self, cell: int, off: bool) -> None:
        """See `CellBank`."""
        if cell not in self._conditions.halted:
            self._settle()
            if off:
                self._outbox.pop(cell, None)
            self._do(cell, lockstep.LEAVE_BUS if off else lockstep.REJOIN_BUS)

    def connect(self, cell: int, errors: Confinement) -> None:
        """See `CellBank`; its process cannot look at them, and reports that it has none."""

    def set_drift(self, cell: int, drift_ppm: int) -> None:
        """See `CellBank`."""
        self._conditions.set_drift(cell, drift_ppm)

    def close(self) -> None:
        """See `CellBank`."""
        self._open.close()


def _identifiers(data: bytes) -> tuple[int, ...]:
    return struct.unpack(f"={len(data) // 2}H", data)
