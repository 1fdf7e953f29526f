"""The speeds of all wheels as the tracker needs them: when, which are known, which wheels stand."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mdms_host.can_link.remote_cell import RemoteCell
from mdms_host.coordination.schedule import Timing
from mdms_host.coordination.speeds.speed_reports import MISSED_SYNCS, SpeedReports
from mdms_host.coordination.speeds.velocity_frames import VelocityFrames
from mdms_model.arrays import Bools, Floats
from mdms_protocol import indices, pdo
from mdms_protocol.dictionary import ENTRIES
from mdms_protocol.entry import steps_per_unit

#: Stands for the speeds of a cell that has not answered.
_NO_SPEEDS = bytes(pdo.ACTUAL_VELOCITY.length)
_WINDOW = ENTRIES[indices.WINDOW, 0]
#: A wheel stands below this speed, as the cells judge it, once it was to stand for so many SYNCs.
_STANDSTILL_M_S = _WINDOW.default / steps_per_unit(_WINDOW.unit)
_STANDSTILL_SYNCS = 3


@dataclass(frozen=True, slots=True)
class Speeds:
    """Speeds of all wheels at a SYNC, those that are known, and wheels that stand, shape (W,)."""

    time_s: float
    speed_m_s: Floats
    known: Bools
    standing: Bools


class Odometry:
    """Takes in SYNCs, speed frames and references, and hands out each SYNC's speeds once.

    `silent` is whether no cell has answered for the time limit.
    """

    def __init__(
        self, cells: Sequence[RemoteCell], axes: int, velocities: VelocityFrames, timing: Timing
    ) -> None:
        self._cells = cells
        self._axes = axes
        self._velocities = velocities
        self._timing = timing
        self._reports = SpeedReports(len(cells))
        self._held_syncs = np.zeros(axes * len(cells), dtype=np.int64)
        self._mute: frozenset[RemoteCell] = frozenset()

    @property
    def silent(self) -> bool:
        """Whether no cell has answered SYNC for the time limit."""
        return len(self._missing(self._timing.speeds_limit_s)) == len(self._cells)

    def on_sync(self, now_s: float) -> None:
        """A SYNC is sent."""
        self._reports.on_sync(now_s)

    def on_speeds(self, cell: RemoteCell, data: bytes, now_s: float) -> None:
        """A speed frame of a cell has arrived; one of another length is counted and dropped."""
        garbage = cell.garbage
        cell.on_speeds(data, now_s)
        if cell.garbage == garbage:
            self._reports.on_speeds(cell.number - 1, data, now_s)

    def on_references(self, references_m_s: Floats) -> None:
        """References of shape (W,) are sent for the next SYNC."""
        self._held_syncs = np.where(references_m_s == 0.0, self._held_syncs + 1, 0)

    def take(self) -> Speeds | None:
        """The newest speeds that can be used, each SYNC's once; None if there are none."""
        sync = self._reports.take()
        if sync is None:
            return None
        numbers = range(len(self._cells))
        speed_m_s = self._velocities.actual_m_s([sync.data.get(n, _NO_SPEEDS) for n in numbers])
        known = np.repeat([number in sync.data for number in numbers], self._axes)
        standing = (self._held_syncs >= _STANDSTILL_SYNCS) & (abs(speed_m_s) < _STANDSTILL_M_S)
        return Speeds(sync.time_s, speed_m_s, known, standing)

    def answers(self, cell: RemoteCell) -> bool:
        """Whether a cell answers SYNC."""
        return self._reports.missed[cell.number - 1] < MISSED_SYNCS

    def fallen_mute(self) -> list[RemoteCell]:
        """Cells that have left three SYNCs in a row unanswered, each once until it answers."""
        missed = self._reports.missed
        mute = [cell for cell in self._cells if missed[cell.number - 1] >= MISSED_SYNCS]
        new = [cell for cell in mute if cell not in self._mute]
        self._mute = frozenset(mute)
        return new

    def late(self) -> tuple[float, list[RemoteCell]]:
        """The time limit for an answer to SYNC [s], and the cells that exceed it.

        Where no cell answers it is the link that is silent, and has as long as for a heartbeat.
        """
        limit_s = self._timing.silence_s if self.silent else self._timing.speeds_limit_s
        return limit_s, self._missing(limit_s) if self._mute else []

    def _missing(self, limit_s: float) -> list[RemoteCell]:
        """Cells that have left as many SYNCs unanswered as fall into so long."""
        limit = round(limit_s / self._timing.sync_period_s)
        missed = self._reports.missed
        return [cell for cell in self._cells if missed[cell.number - 1] >= limit]
