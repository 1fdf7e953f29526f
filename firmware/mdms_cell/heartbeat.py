"""Heartbeat producer (CiA 301, 7.2.8.2.2.3)."""

from mdms_cell import ticks
from mdms_protocol import cob

PRODUCER_TIME = 0x1017


class Heartbeat:
    """Sends the cell's state at the period of 0x1017, which is 0 for never."""

    def __init__(self, objects, send):
        self._objects = objects
        self._send = send
        self._period_ms = 0
        self._due_ms = 0
        self.now_ms = 0
        objects.watchers[PRODUCER_TIME] = self._configure

    def start(self, now_ms):
        """Begin a period, at boot-up or when the period changed."""
        self._period_ms = self._objects.number(PRODUCER_TIME)
        self._due_ms = ticks.after(now_ms, self._period_ms)

    def poll(self, now_ms, node_id, state):
        """Send a heartbeat if it is due; return in how many milliseconds the next one is.

        One that is late does not delay those after it.
        """
        self.now_ms = now_ms
        if not self._period_ms:
            return ticks.IDLE_MS
        wait_ms = ticks.diff(self._due_ms, now_ms)
        if wait_ms <= 0:
            self._send(cob.HEARTBEAT_BASE + node_id, bytes((state,)))
            wait_ms += self._period_ms
            if wait_ms <= 0:
                wait_ms = self._period_ms
            self._due_ms = ticks.after(now_ms, wait_ms)
        return wait_ms

    def _configure(self, _index, _sub):
        self.start(self.now_ms)
