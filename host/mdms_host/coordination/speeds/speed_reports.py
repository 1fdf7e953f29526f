"""The cells' speeds, each with the SYNC that it answers, and cells that do not answer."""

from collections import deque
from dataclasses import dataclass, field

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

    @property
    def missed(self) -> list[int]:
        """How many SYNCs in a row each cell has not answered, up to the last one."""
        return [self._sent - answered for answered in self._answered]

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
        awaited = {cell for cell, missed in enumerate(self.missed) if missed < MISSED_SYNCS}
        for sync in reversed(self._syncs):
            if sync.number <= self._taken:
                return None
            if sync.data and (sync.number < self._sent or awaited <= sync.data.keys()):
                self._taken = sync.number
                return sync
        return None
