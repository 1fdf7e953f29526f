"""Firmware over the bus: how long 18 cells take, and what becomes of cells that are cut off.

The time is that of the virtual bus, with the cells' firmware and the host's updater; a cell stands
still for as long as its flash needs, at most, to erase a block and to program pages (W25Q64). Then
a cell of real MicroPython is ended by kill -9 at operations of its flash and at frames, each on a
flash of its own: afterwards it has to boot with the motors off, report its version, have its
settings, and take the firmware.
"""

import random
import tempfile
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import count
from math import ceil
from pathlib import Path
from typing import Any

from tests.system.flashing.flashed_cell import (
    NODE,
    FlashedCell,
    booted,
    bundle,
    commissioned,
    drive,
    powered,
    report,
)
from tests.system.flashing.test_update import BEFORE, BITRATE, after, small

from mdms_host.flashing.bundles import Bundle, packed_firmware, sign
from mdms_host.flashing.cell_update import CellUpdate
from mdms_host.flashing.updater import Updater
from mdms_model.scenario.file import load_scenario
from mdms_protocol.codecs.frame import Frame
from mdms_sim.nodes.python_bank import PythonBank
from mdms_sim.nodes.virtual_board import VirtualBoard
from mdms_sim.simulation import Simulation

CELLS = 18
KEY = bytes(range(32))
SLOTS = ("mdms_slots/1", "mdms_slots/2")
BITRATES = (1_000_000, 500_000)
LIMIT_S = 60.0
BOOT_S = 0.5
# The flash of a Teensy 4.1 and of a WeAct board, at its slowest.
BLOCK, PAGE = 4096, 256
ERASE_MS, PROGRAM_MS = 400.0, 3.0
#: Cuts of the whole firmware, of some 480 operations and 16,100 frames.
CUTS = 24
SEED = 16


def run() -> list[dict[str, Any]]:
    """Seconds for all cells by bit rate, and cells that are well after cuts, of how many."""
    rows = [timed(bitrate) for bitrate in BITRATES]
    with tempfile.TemporaryDirectory() as folder:
        first = commissioned(Path(folder))
        rows.append(counted("cut at each operation, small bundle", every_operation(first, folder)))
        rows.append(
            counted("cut at each operation, on trial", every_operation_on_trial(first, folder))
        )
        rows.append(counted("cut at operations, whole firmware", some_operations(first, folder)))
        rows.append(counted("cut at frames, whole firmware", some_frames(first, folder)))
    return rows


def row(name: str, ours: float, limit: float, unit: str, **more: object) -> dict[str, Any]:
    """One line of the table; the peer is the required limit."""
    return {
        "name": name,
        "ours": ours,
        "peer": limit,
        "ratio": ours / limit,
        "unit": unit,
        **more,
    }


class SlowFlash(PythonBank):
    """Cells that stand still while their flash is written; nothing leaves them meanwhile."""

    def __init__(self, cells: int) -> None:
        self._until_ticks = [0] * cells
        super().__init__(range(1, cells + 1))

    def _written(self, cell: int) -> int:
        files = self._flash[cell].files
        return sum(files.size(path) for path in SLOTS if path in files._files)

    def deliver(self, cell: int, frame: Frame) -> None:
        """See `CellBank`."""
        before = self._written(cell)
        super().deliver(cell, frame)
        after = self._written(cell)
        blocks = after // BLOCK - before // BLOCK
        pages = after // PAGE - before // PAGE
        if pages > 0:
            now = self._conditions.ticks
            self._until_ticks[cell] = now + ceil(blocks * ERASE_MS + pages * PROGRAM_MS)

    def collect(self, cell: int) -> list[Frame]:
        """See `CellBank`."""
        stands = self._conditions.ticks < self._until_ticks[cell]
        return [] if stands else super().collect(cell)


@dataclass
class Delayed:
    """The updater as a participant that begins when the cells have booted."""

    updater: Updater

    @property
    def wake_s(self) -> float:
        """See `Participant`."""
        return max(self.updater.wake_s, BOOT_S)

    def on_frame(self, frame: Frame, now_s: float) -> None:
        """See `Participant`."""
        if now_s >= BOOT_S:
            self.updater.on_frame(frame, now_s)

    def poll(self, now_s: float) -> Any:
        """See `Participant`."""
        return self.updater.poll(now_s)


def timed(bitrate: int) -> dict[str, Any]:
    """All cells of the prototype at once."""
    scenario = load_scenario("array18", ["run.fidelity=firmware", f"wire.bitrate={bitrate}"])
    sent = sign(packed_firmware(VirtualBoard.bytecode), KEY, 1, VirtualBoard.bytecode)
    with closing(SlowFlash(CELLS)) as bank:
        for cell in range(CELLS):
            bank._flash[cell].files.replace("update.key", KEY)
            bank.restart(cell)
        updater = Updater([CellUpdate(node, sent) for node in range(1, CELLS + 1)], bitrate)
        simulation = Simulation(scenario, bank, [Delayed(updater)], recording=None)
        simulation.run_until(10 * LIMIT_S, over=lambda: updater.over)
        assert all(each.finished for each in updater.updates)
        return row(
            f"{CELLS} cells, {bitrate // 1000} kbit/s",
            updater.ended_s - BOOT_S,
            LIMIT_S,
            "s",
            load=simulation.bus.load(),
            kilobytes=len(sent.data) / 1000,
            frames=updater.frames,
            repeated=sum(each.repeated for each in updater.updates),
        )


@dataclass
class Cut:
    """Where a cell is to be cut off: at an operation of a life, or after so many frames."""

    sent: Bundle
    operation: int = -1
    frames: int = 1 << 30


def every_operation(first: bytes, folder: str) -> Iterator[str | None]:
    """A bundle of the board's own files, cut at each operation of its way into flash."""
    sent = small()
    for operation in range(operations(first, folder, sent)):
        yield survives(first, folder, Cut(sent, operation))


def every_operation_on_trial(first: bytes, folder: str) -> Iterator[str | None]:
    """A bundle of the board's own files, cut from its first start to its confirmation."""
    sent = small()
    for operation in count():
        with powered(fresh(folder), first) as cell:
            booted(cell)
            cell.cut_on_trial = operation
            if update(cell, sent, lambda _frames: False).finished:
                return
            for _ in range(2):
                cell.power_off()
                cell.power_up()
                booted(cell)
            found = report(cell)
            yield None if found in (BEFORE, after(sent)) else str(found)


def some_operations(first: bytes, folder: str) -> Iterator[str | None]:
    """The whole firmware, cut at operations by chance."""
    sent = bundle()
    picked = random.Random(SEED).sample(range(operations(first, folder, sent)), CUTS)
    for operation in sorted(picked):
        yield survives(first, folder, Cut(sent, operation))


def some_frames(first: bytes, folder: str) -> Iterator[str | None]:
    """The whole firmware, cut after frames by chance, wherever the program is then."""
    sent = bundle()
    frames = len(sent.data) // 7
    for number in sorted(random.Random(SEED + 1).sample(range(frames), CUTS)):
        yield survives(first, folder, Cut(sent, frames=number))


def operations(first: bytes, folder: str, sent: Bundle) -> int:
    """How often the flash is changed until the new firmware is to be started."""
    with powered(fresh(folder), first) as cell:
        booted(cell)
        assert update(cell, sent, lambda _frames: False).finished
        return int(cell.operations[0])


def survives(first: bytes, folder: str, cut: Cut) -> str | None:
    """The fault of a cell after a cut, or of its next update; None without a fault."""
    with powered(fresh(folder), first, cut.operation) as cell:
        booted(cell)
        if update(cell, cut.sent, lambda frames: frames >= cut.frames).over:
            return "it was not cut off"
        cell.power_off()
        cell.power_up()
        booted(cell)
        found = report(cell)
        version = cut.sent.version if found.slot else BEFORE.version
        if replace(found, on_trial=False) not in (BEFORE, after(cut.sent, version)):
            return str(found)
        if found.on_trial:
            cell.power_off()
            cell.power_up()
            booted(cell)
        return update(cell, cut.sent, lambda _frames: False).failure


def update(cell: FlashedCell, sent: Bundle, cut: Callable[[int], bool]) -> CellUpdate:
    """How far a cell has come with a bundle; `cut(frames)` ends it by force."""
    one = CellUpdate(NODE, sent)
    updater = Updater([one], BITRATE)
    drive(cell, updater, lambda: updater.over or cut(updater.frames))
    return one


def fresh(folder: str) -> Path:
    """A folder for a cell of its own."""
    return Path(tempfile.mkdtemp(dir=folder)) / "cell"


def counted(name: str, outcomes: Iterator[str | None]) -> dict[str, Any]:
    """The number of cells that are well, of all cells; the faults of the others."""
    found = list(outcomes)
    wrong = [text for text in found if text is not None]
    return row(name, len(found) - len(wrong), len(found), "cells", wrong="; ".join(wrong) or None)
