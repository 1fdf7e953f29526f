"""Firmware cells and the host's link to them in virtual time: no machine is too slow for them."""

from collections import deque
from collections.abc import Callable

import numpy as np

from mdms_cell.drive import speed_loop
from mdms_host.can_link.delays import Delays
from mdms_host.can_link.link import Incidents, Link, LinkCounts
from mdms_protocol import indices
from mdms_protocol.codecs import cob
from mdms_protocol.codecs.frame import Frame
from mdms_sim.nodes.python_bank import PythonBank

TICK_S = 0.001
#: A link waits for a frame no longer than this, even if more is asked.
READ_TIMEOUT_S = 0.1


class CellsLink(Link):
    """A link whose cells live through exactly the time that the host waits in `receive`.

    Nothing lies on the cells, and no wheel turns. Frames to and from `cut` cells (from 0) get lost.
    Left out: a device that fails.
    """

    is_real = False

    def __init__(self, node_ids: tuple[int, ...]) -> None:
        self.states: dict[int, int] = {}
        self.cut: set[int] = set()
        self._dead: set[int] = set()
        self.delays = Delays()
        self._clock = self
        self._incidents = Incidents(self)
        self._bank = PythonBank(node_ids)
        self._counts = np.zeros((len(node_ids), 2), np.int32)
        self._presence = np.zeros(len(node_ids), np.uint8)
        self._ticks = 0
        self._now_s = 0.0
        self._waiting: deque[tuple[Frame, float]] = deque()
        while len(self.states) < len(node_ids):
            self._now_s = self._ticks * TICK_S
            self._tick()
        self._waiting.clear()

    def power_off(self, *cells: int) -> None:
        """All cells (from 0), or these."""
        for cell in cells or range(len(self._counts)):
            self._dead.add(cell)
            self._bank.power_off(cell)

    def restart(self, cell: int, serial: int | None = None) -> None:
        """A cell (from 0) starts anew; with a serial number, another board does in its place."""
        self._dead.discard(cell)
        self._bank.restart(cell)
        if serial is not None:
            self._bank._cells[cell]._objects.put(indices.IDENTITY, 4, serial)

    def set_supply(self, cell: int, supply_v: float) -> None:
        """The supply of a cell's (from 0) motors."""
        self._bank.set_supply(cell, round(supply_v * 1e6))

    def set_bus_off(self, cell: int, off: bool) -> None:
        """The controller of a cell (from 0) goes bus off, or comes back."""
        self._bank.set_bus_off(cell, off)

    def number(self, cell: int, index: int, subindex: int) -> int:
        """The value of an object of a cell."""
        return self._bank._cells[cell]._objects.number(index, subindex)

    def targets_um_s(self, cell: int) -> list[int]:
        """The targets of the axes of a cell (from 0) now: 0 where a motor is off."""
        if cell in self._dead:
            return [0, 0]
        drives = self._bank._cells[cell]._axes._drives
        return [drive.registers[drive.base + speed_loop.TARGET] for drive in drives]

    def now_s(self) -> float:
        return self._now_s

    def sleep(self, seconds: float) -> None:
        self._pass_until(self._now_s + seconds, lambda: False)

    @property
    def counts(self) -> LinkCounts:
        return LinkCounts(0, 0, 0, 0)

    def send(self, frame: Frame, until_s: float | None = None) -> None:
        for cell in range(len(self._counts)):
            if cell not in self.cut:
                self._bank.deliver(cell, frame)

    def receive(self, timeout_s: float, handle: Callable[[Frame, float], object]) -> None:
        wait_s = max(0.0, min(timeout_s, READ_TIMEOUT_S))
        self._pass_until(self._now_s + wait_s, lambda: bool(self._waiting))
        for _ in range(len(self._waiting)):
            handle(*self._waiting.popleft())

    def close(self) -> None:
        self._waiting.clear()

    def _pass_until(self, end_s: float, over: Callable[[], bool]) -> None:
        while not over() and self._now_s < end_s:
            next_s = self._ticks * TICK_S
            self._now_s = min(end_s, next_s)
            if next_s <= end_s:
                self._tick()

    def _tick(self) -> None:
        self._bank.tick(self._counts, np.zeros_like(self._counts), self._presence)
        self._ticks += 1
        for cell, frames in self._bank.collect_all():
            for frame in () if cell in self.cut else frames:
                self._waiting.append((frame, self._now_s))
                node_id = frame.can_id - cob.HEARTBEAT_BASE
                if 0 < node_id < cob.NODE_MAX:
                    self.states[node_id] = frame.data[0]
