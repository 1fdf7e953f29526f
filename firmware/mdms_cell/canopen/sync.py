"""The common beat: SYNC from outside, or one of the cells takes over.

SYNC has no sender. Two nodes may never send one identifier with different data, so it can have
none. But a cell can tell another's SYNC from its own:

- A producer that sees another's SYNC yields. So the host's SYNC wins. If two beats meet after a
  partition has healed, the first SYNC wins.
- A cell that misses SYNC for two beats and a half takes over, a millisecond later for each rank. So
  the next rank is silenced by it. Up to rank 22 the gap stays below 50 ms.
- Two producers whose SYNCs cross on their way both yield. So a cell that has yielded, and has not
  seen two other beats in turn, returns after one beat and a half, the lower rank first.

Two producers that begin at the same bit send one frame, and are one beat.
"""

from mdms_cell import ticks
from mdms_protocol.compat import const, micropython

#: Half beats without SYNC before a cell takes over, and before it returns after it has yielded.
MISSED_HALVES = 5
YIELDED_HALVES = 3
RANK_MS = 1
_WRAP = const((1 << 30) - 1)  # of the clock, see `ticks`


class Beat:
    """When this cell is to send SYNC; off until it is configured and started.

    `enabled` is whether it may be, `producing` whether it is.
    """

    def __init__(self):
        self.producing = False
        self.enabled = False
        self._alive = False
        self._period_ms = 10
        # From a SYNC on: until this cell takes over, and until it returns where it has yielded.
        self._missed_ms = self._yielded_ms = 0
        self._due_ms = 0

    def configure(self, enabled, rank, period_ms, now_ms):
        """Take settings: whether to take over at all, which in line, the period of SYNC."""
        self.enabled = enabled
        self._period_ms = period_ms
        self._missed_ms = MISSED_HALVES * period_ms // 2 + rank * RANK_MS
        self._yielded_ms = YIELDED_HALVES * period_ms // 2 + rank * RANK_MS
        self._follow(now_ms)

    def start(self, now_ms):
        """The cell is 'operational' from now on."""
        self._alive = True
        self._follow(now_ms)

    def stop(self):
        """The cell is not 'operational' any more."""
        self._alive = False
        self.producing = False

    @micropython.native
    def on_sync(self, now_ms):
        """A SYNC has come from elsewhere."""
        delay_ms = self._yielded_ms if self.producing else self._missed_ms
        self.producing = False
        self._due_ms = now_ms + delay_ms & _WRAP

    def poll(self, now_ms):
        """Whether to send SYNC now; one that finds no room is left out."""
        if self.wait_ms(now_ms) > 0:
            return False
        late_ms = ticks.diff(now_ms, self._due_ms)
        start_ms = self._due_ms if self.producing and late_ms < self._period_ms else now_ms
        self.producing = True
        self._due_ms = ticks.after(start_ms, self._period_ms)
        return True

    def wait_ms(self, now_ms):
        """In how many milliseconds to poll, unless a SYNC comes before."""
        if not self.enabled or not self._alive:
            return ticks.IDLE_MS
        return max(ticks.diff(self._due_ms, now_ms), 0)

    def _follow(self, now_ms):
        """Send nothing until so many beats have been missed that this cell takes over."""
        self.producing = False
        self._due_ms = ticks.after(now_ms, self._missed_ms)
