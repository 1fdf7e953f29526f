"""Transmit PDOs (CiA 301, 7.2.2.3): values sent at SYNC, on change, or by the event timer."""

import struct

from mdms_cell import ticks
from mdms_cell.pdo import EVENT_TIMER, INHIBIT_TIME, Pdo
from mdms_protocol import record

PARAMETERS = 0x1800
MAPPING = 0x1A00

_INHIBIT_UNITS_PER_MS = 10


class Tpdo(Pdo):
    """Transmit PDO `number`, counted from 0; `changed()` is told of another identifier."""

    def __init__(self, number, objects, send, changed):
        super().__init__(objects, PARAMETERS + number, MAPPING + number, record.IN_TPDO, changed)
        self._send = send
        self._syncs = 0
        self._sent_ms = None
        self.load()

    def load(self):
        """Take over everything from the dictionary."""
        super().load()
        readers = [self._objects.reader(index, sub) for index, sub, _ in self.entries()]
        self._reads = [read for read, _ in readers]
        self._layout = "<" + "".join([form[1] for _, form in readers])
        self._sent = None
        # The clock has no finer ticks: the time is rounded up.
        self._inhibit_ms = -(-self._parameter(INHIBIT_TIME) // _INHIBIT_UNITS_PER_MS)
        self._event_ms = 0 if self.synchronous else self._parameter(EVENT_TIMER)

    def start(self):
        """Begin anew, on entering 'operational'."""
        self._sent = None
        self._sent_ms = None
        self._syncs = 0

    def on_sync(self):
        """Send, if the transmission type says so: 0 on change, n at every n-th SYNC."""
        if not self.synchronous:
            return
        data = self._data()
        if self.type:
            self._syncs += 1
            if self._syncs < self.type:
                return
            self._syncs = 0
        elif data == self._sent:
            return
        self._sent = data
        self._send(self.can_id, data)

    def poll(self, now_ms):
        """Send what has changed or has not been sent for long, but not too often."""
        if self.synchronous:
            return
        data = self._data()
        if self._sent_ms is not None:
            elapsed_ms = ticks.diff(now_ms, self._sent_ms)
            overdue = self._event_ms and elapsed_ms >= self._event_ms
            if elapsed_ms < self._inhibit_ms or not (overdue or data != self._sent):
                return
        if self._send(self.can_id, data):
            self._sent = data
            self._sent_ms = now_ms

    @property
    def timed(self):
        """Whether it is to be polled every millisecond."""
        return self._event_ms > 0

    def _data(self):
        return struct.pack(self._layout, *[read() for read in self._reads])
