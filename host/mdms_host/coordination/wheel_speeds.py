"""The speeds of wheels on the wire: setpoints in frames out, and reports with their times in."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mdms_host.can_link.remote_cell import RemoteCell
from mdms_host.coordination.run_state import Timing
from mdms_model.arrays import Bools, Floats, Ints
from mdms_protocol import indices, pdo
from mdms_protocol.codecs.frame import Frame
from mdms_protocol.dictionary import ENTRIES
from mdms_protocol.entry import steps_per_unit

#: A cell that leaves this many SYNCs in a row unanswered is not waited for any more.
MISSED_SYNCS = 3
#: How many SYNCs an answer may be late.
_KEPT_SYNCS = 4


@dataclass(slots=True)
class Sync:
    """A SYNC, when it was sent [s], and the data of the cells (from 0) that have answered it."""

    number: int
    time_s: float
    data: dict[int, bytes] = field(default_factory=dict)


class SpeedReports:
    """Sorts the speed frames of so many cells by the SYNCs they answer.

    A frame answers the last SYNC that was sent before it arrived, however late it is handled.
    """

    def __init__(self, cells: int) -> None:
        self._syncs: deque[Sync] = deque(maxlen=_KEPT_SYNCS)
        self._sent = 0
        self._answered = [0] * cells
        self._taken = 0

    def missing(self, syncs: int) -> list[int]:
        """The cells that have left so many SYNCs in a row unanswered, up to the last one."""
        latest = self._sent - syncs
        if min(self._answered) > latest:
            return []  # as nearly always
        return [cell for cell, answered in enumerate(self._answered) if answered <= latest]

    def on_sync(self, now_s: float) -> None:
        """A SYNC is sent."""
        self._sent += 1
        self._syncs.append(Sync(self._sent, now_s))

    def on_speeds(self, cell: int, data: bytes, now_s: float) -> None:
        """A speed frame of a cell has arrived; one older than all SYNCs kept is dropped."""
        for sync in reversed(self._syncs):
            if now_s >= sync.time_s:
                sync.data[cell] = data
                self._answered[cell] = max(self._answered[cell], sync.number)
                return

    def take(self) -> Sync | None:
        """The newest SYNC whose answers can be used, each SYNC once; None if there is none.

        The last SYNC counts when it is complete, an older one with the answers that came. So a cell
        that is late, or has missed a SYNC, delays its neighbours' speeds by one SYNC at most.
        """
        for sync in reversed(self._syncs):
            if sync.number <= self._taken:
                return None
            if sync.data and (sync.number < self._sent or self._is_complete(sync)):
                self._taken = sync.number
                return sync
        return None

    def _is_complete(self, sync: Sync) -> bool:
        """Whether all cells that are waited for have answered."""
        cells = range(len(self._answered))
        if len(sync.data) == len(cells):
            return True
        unanswered = {cell for cell in cells if cell not in sync.data}
        return unanswered <= set(self.missing(MISSED_SYNCS))


_TARGET, _ACTUAL = pdo.TARGET_VELOCITY, pdo.ACTUAL_VELOCITY
#: All axes of a cell have the same type and limits.
_AXIS = _TARGET.entries[0]
_UM_PER_M = steps_per_unit(_AXIS.unit)
_WIRE = np.dtype(f"<i{_AXIS.type.size}")


class VelocityFrames:
    """Turns velocities of shape (W,), ordered by cell, then by axis, into frames and back.

    All cells at once: one by one would cost the coordinator most of its time. Raises ValueError
    for cells of more axes than the wire has.
    """

    def __init__(self, node_ids: Sequence[int], axes: int) -> None:
        if axes > len(_TARGET.entries):
            raise ValueError(
                f"a cell has {len(_TARGET.entries)} axes on the wire, the layout wants {axes}"
            )
        self._axes = axes
        self._can_ids = [_TARGET.can_id(node_id) for node_id in node_ids]
        self._targets_um_s = np.zeros((len(node_ids), len(_TARGET.entries)), _WIRE)
        #: The data of all frames that were encoded last, in one, and the frames.
        self._last: tuple[bytes, list[Frame]] = (b"", [])

    def targets(self, references_m_s: Floats) -> list[Frame]:
        """Each cell's setpoints, zero for axes that are not used. Raises OutOfRangeError."""
        um_s = np.rint(references_m_s * _UM_PER_M).astype(np.int64).reshape(-1, self._axes)
        if not _AXIS.low <= um_s.min() <= um_s.max() <= _AXIS.high:
            _refuse(um_s)
        self._targets_um_s[:, : self._axes] = um_s
        data, size = self._targets_um_s.tobytes(), _TARGET.length
        if data != self._last[0]:
            cells = zip(self._can_ids, range(0, len(data), size), strict=True)
            frames = [Frame(can_id, data[start : start + size]) for can_id, start in cells]
            self._last = data, frames
        return self._last[1]

    def actual_m_s(self, data: Sequence[bytes]) -> Floats:
        """The speeds in the state frames of all cells, shape (W,)."""
        um_s = np.frombuffer(b"".join(data), _WIRE).reshape(-1, len(_ACTUAL.entries))
        return um_s[:, : self._axes].ravel() / _UM_PER_M


def _refuse(um_s: Ints) -> None:
    """Raises OutOfRangeError for the first value that no drive takes."""
    for values in um_s.tolist():
        for entry, value in zip(_TARGET.entries, values, strict=False):
            pdo.check(entry, value)


#: Stands for the speeds of a cell that has not answered.
_NO_SPEEDS = bytes(pdo.ACTUAL_VELOCITY.length)
_WINDOW = ENTRIES[indices.WINDOW, 0]
#: A wheel stands below this speed, as the cells judge it, once it was to stand for so many SYNCs.
_STANDSTILL_M_S = _WINDOW.default / steps_per_unit(_WINDOW.unit)
_STANDSTILL_SYNCS = 3


@dataclass(frozen=True, slots=True)
class SyncedSpeeds:
    """Speeds of all wheels at a SYNC, those that are known, and wheels that stand, shape (W,).

    `lost` is whether a cell is missing that has answered the SYNC before.
    """

    time_s: float
    speed_m_s: Floats
    known: Bools
    standing: Bools
    lost: bool


class Odometry:
    """Takes in speed frames and references, and hands out each SYNC's speeds once.

    `reports` takes in each SYNC. `silent` is whether no cell has answered for the time limit.
    """

    def __init__(
        self, cells: Sequence[RemoteCell], axes: int, velocities: VelocityFrames, timing: Timing
    ) -> None:
        self._cells = cells
        self._axes = axes
        self._velocities = velocities
        self._timing = timing
        self.reports = SpeedReports(len(cells))
        self._held_syncs = np.zeros(axes * len(cells), dtype=np.int64)
        self._known: Bools = np.zeros(axes * len(cells), dtype=bool)
        self._mute: frozenset[RemoteCell] = frozenset()

    @property
    def silent(self) -> bool:
        """Whether no cell has answered SYNC for the time limit."""
        return len(self._missing(self._timing.speeds_limit_s)) == len(self._cells)

    def on_speeds(self, cell: RemoteCell, data: bytes, now_s: float) -> None:
        """A speed frame of a cell has arrived; one of another length is counted and dropped."""
        garbage = cell.garbage
        cell.on_speeds(data, now_s)
        if cell.garbage == garbage:
            self.reports.on_speeds(cell.number - 1, data, now_s)

    def on_references(self, references_m_s: Floats) -> None:
        """References of shape (W,) are sent for the next SYNC."""
        self._held_syncs = np.where(references_m_s == 0.0, self._held_syncs + 1, 0)

    def take(self) -> SyncedSpeeds | None:
        """The newest speeds that can be used, each SYNC's once; None if there are none."""
        sync = self.reports.take()
        if sync is None:
            return None
        numbers = range(len(self._cells))
        speed_m_s = self._velocities.actual_m_s([sync.data.get(n, _NO_SPEEDS) for n in numbers])
        known = np.array([number in sync.data for number in numbers]).repeat(self._axes)
        standing = (self._held_syncs >= _STANDSTILL_SYNCS) & (abs(speed_m_s) < _STANDSTILL_M_S)
        lost = bool((self._known & ~known).any())
        self._known = known
        return SyncedSpeeds(sync.time_s, speed_m_s, known, standing, lost)

    def answers(self, cell: RemoteCell) -> bool:
        """Whether a cell answers SYNC."""
        return cell.number - 1 not in self.reports.missing(MISSED_SYNCS)

    def fallen_mute(self) -> list[RemoteCell]:
        """Cells that have left three SYNCs in a row unanswered, each once until it answers."""
        mute = self._without_answer(MISSED_SYNCS)
        new = [cell for cell in mute if cell not in self._mute]
        self._mute = frozenset(mute)
        return new

    def late(self) -> tuple[float, list[RemoteCell]]:
        """The time limit for an answer to SYNC [s], and the cells that exceed it.

        Where no cell answers it is the link that is silent, and has as long as for a heartbeat.
        """
        if not self._mute:
            return self._timing.speeds_limit_s, []
        limit_s = self._timing.silence_s if self.silent else self._timing.speeds_limit_s
        return limit_s, self._missing(limit_s)

    def _missing(self, limit_s: float) -> list[RemoteCell]:
        """Cells that have left as many SYNCs unanswered as fall into so long."""
        return self._without_answer(round(limit_s / self._timing.sync_period_s))

    def _without_answer(self, syncs: int) -> list[RemoteCell]:
        """Cells that have left so many SYNCs in a row unanswered."""
        numbers = self.reports.missing(syncs)
        return [cell for cell in self._cells if cell.number - 1 in numbers] if numbers else []
