"""Transmit PDOs (CiA 301, 7.2.2.3): values sent at SYNC, on change, or by the event timer."""

from struct import pack

from mdms_cell import ticks
from mdms_cell.canopen.pdo.base import Pdo
from mdms_cell.canopen.rules import EVENT_TIMER, INHIBIT_TIME
from mdms_protocol import indices, record
from mdms_protocol.compat import micropython

_INHIBIT_UNITS_PER_MS = 10
#: Presence and statuswords: a poll follows when they change. All else may change at any time.
_ANNOUNCED = (
    indices.PRESENCE,
    indices.STATUSWORD,
    indices.STATUSWORD + indices.AXIS_OFFSET,
)


class Tpdo(Pdo):
    """Transmit PDO `number`, counted from 0.

    `on_sync` is for a synchronous one, `trigger` for one of type 254, `poll` for one of type 255;
    see `Pdo` for `changed`. `refused` is the change for which there was no room at SYNC.
    """

    def __init__(self, number, objects, send, changed):
        parameters, mapping = indices.TPDO_PARAMETERS + number, indices.TPDO_MAPPING + number
        super().__init__(objects, parameters, mapping, record.IN_TPDO, changed)
        self._send = send
        self._syncs = 0
        self._sent_ms = None
        self.load()

    def load(self):
        """Take over everything from the dictionary."""
        super().load()
        entries = self.entries()
        readers = [self._objects.reader(index, sub) for index, sub, _ in entries]
        self._reads = [read for read, _ in readers]
        self._values = [0] * len(readers)
        self._stored = self._objects.stored(entries)
        formats = [form[1] for _, form in readers]
        self._layout = "<" + "".join(formats)
        announced = all(index in _ANNOUNCED for index, _, _ in entries)
        self._pace_ms = ticks.IDLE_MS if announced else ticks.RETRY_MS
        self._sent = None
        self.refused = None
        # The clock has no finer ticks: the time is rounded up.
        self._inhibit_ms = -(-self._parameter(INHIBIT_TIME) // _INHIBIT_UNITS_PER_MS)
        self._event_ms = self._parameter(EVENT_TIMER)

    def start(self):
        """Begin anew, on entering 'operational'."""
        self._sent = None
        self._sent_ms = None
        self.refused = None
        self._syncs = 0

    @micropython.native
    def on_sync(self):
        """Send, if the transmission type says so: 0 on change, n at every n-th SYNC.

        Returns False if there was no room for a change, which `retry` is to send. A periodic frame
        is not repeated: the next comes by itself, and late ones would only fill the bus further.
        """
        data = self._data()
        period = self.type
        if period:
            syncs = self._syncs + 1
            if syncs >= period:
                syncs = 0
                self._send(self.can_id, data)
            self._syncs = syncs
            return True
        self.refused = None if data == self._sent else data
        return self.retry()

    def retry(self):
        """Send the change that there was no room for at SYNC; return False if there is none yet."""
        data = self.refused
        if data is None:
            return True
        if not self._send(self.can_id, data):
            return False
        self._sent = data
        self.refused = None
        return True

    @micropython.native
    def trigger(self):
        """Send what is mapped; return False if there was no room."""
        return self._send(self.can_id, self._data())

    @micropython.native
    def poll(self, now_ms):
        """Send what has changed or has not been sent for long, but not too often.

        Returns in how many milliseconds to poll again, if nothing is announced before.
        """
        data = self._data()
        elapsed_ms = self._inhibit_ms
        if self._sent_ms is not None:
            elapsed_ms = ticks.diff(now_ms, self._sent_ms)
        if data != self._sent or (self._event_ms and elapsed_ms >= self._event_ms):
            if 0 <= elapsed_ms < self._inhibit_ms:
                return self._inhibit_ms - elapsed_ms
            if not self._send(self.can_id, data):
                return ticks.RETRY_MS
            self._sent = data
            self._sent_ms = now_ms
            elapsed_ms = 0
        if self._event_ms:
            return min(self._pace_ms, self._event_ms - elapsed_ms)
        return self._pace_ms

    @micropython.native
    def _data(self):
        if self._stored is not None:
            return bytes(self._stored)
        values, number = self._values, 0
        for read in self._reads:
            values[number] = read()
            number += 1  # noqa: SIM113 - machine code has no `enumerate` of its own
        return pack(self._layout, *values)
