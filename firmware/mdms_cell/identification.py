"""A cell that is to be told from the others: its board's LEDs blink for a while (0x3007)."""

from mdms_cell import ticks
from mdms_protocol import indices


class Identification:
    """Reads and writes of 0x3007: for how much longer the board is to blink [ms].

    It ends by itself, however long ago the host has gone. `blink(on)` is the board's.
    """

    def __init__(self, objects, blink, attend):
        self._blink = blink
        self._attend = attend
        self._until_ms = None
        objects.tie(indices.IDENTIFY, 0, self.left_ms, self.start)

    def left_ms(self):
        """How much longer it goes on, 0 while it does not."""
        until_ms = self._until_ms
        return 0 if until_ms is None else max(ticks.diff(until_ms, self._attend()), 0)

    def start(self, time_ms):
        """Blink for so long from now on; 0 ends it."""
        self._until_ms = ticks.after(self._attend(), time_ms) if time_ms else None
        self._blink(time_ms != 0)

    def poll(self, now_ms):
        """End it when its time is over; return in how many milliseconds that is."""
        if self._until_ms is None:
            return ticks.IDLE_MS
        wait_ms = ticks.diff(self._until_ms, now_ms)
        if wait_ms <= 0:
            self.start(0)
            return ticks.IDLE_MS
        return wait_ms
