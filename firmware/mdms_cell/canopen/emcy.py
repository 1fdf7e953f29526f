"""Emergency messages, error register and error history (CiA 301, 7.2.7, 0x1001, 0x1003)."""

from mdms_cell import ticks
from mdms_cell.canopen.objects import WHOLE
from mdms_cell.canopen.rules import check_cob_id
from mdms_protocol import indices
from mdms_protocol.codecs import cob, sdo

_HISTORY_SIZE = 8
#: Messages that may wait for the inhibit time or for room; older ones give way.
_QUEUE_SIZE = 8

_GENERIC = 0x01
#: The bit of the error register that the upper half byte of an error code sets besides.
_REGISTER_BITS = {0x2: 0x02, 0x3: 0x04, 0x4: 0x08, 0x7: 0x20, 0x8: 0x10, 0xF: 0x80}


class Emcy:
    """The errors of the cell, by source; a source has one error at a time.

    `errors` has their codes by their sources, and `queue` the messages that wait to be sent.
    """

    def __init__(self, objects, send):
        self._objects = objects
        self._send = send
        self.errors = {}
        self.queue = []
        self._sent_ms = None
        objects.tie(indices.ERROR_REGISTER, 0, read=self.register)
        objects.tie(indices.ERROR_HISTORY, 0, write=self._clear_history)
        objects.tie(indices.ERROR_HISTORY, WHOLE, read=self._check_history)
        objects.watch(self._on_cob_id, indices.EMCY_COB_ID)
        objects.watch(self._on_inhibit_time, indices.EMCY_INHIBIT_TIME)
        self.load()

    def load(self):
        """Take over identifier and inhibit time from the dictionary."""
        cob_id = self._objects.number(indices.EMCY_COB_ID)
        self.can_id = None if cob_id & cob.INVALID else cob_id & cob.IDENTIFIER
        self._inhibit_ms = -(-self._objects.number(indices.EMCY_INHIBIT_TIME) // 10)

    def register(self):
        """The error register."""
        bits = 0
        for code in self.errors.values():
            bits |= _GENERIC | _REGISTER_BITS.get(code >> 12, 0)
        return bits

    def report(self, source, code, detail=bytes(4)):
        """An error has come up; four bytes may give details."""
        if self.errors.get(source) == code:
            return
        self.errors[source] = code
        if source < 10:  # a refused start is told each time, and would soon leave no other
            self._remember(source << 16 | code)
        self._post(source, code, detail)

    def clear(self, source):
        """The error of this source is gone, if there was one."""
        if source in self.errors:
            del self.errors[source]
            self._post(source, 0, bytes(4))  # code 0: no error

    def poll(self, now_ms):
        """Send waiting messages, one an inhibit time; return when to go on [ms from now]."""
        while self.queue and self.can_id is not None:
            wait_ms = self._inhibited_ms(now_ms)
            if wait_ms:
                return wait_ms
            if not self._send(self.can_id, self.queue[0]):
                return ticks.RETRY_MS
            self.queue.pop(0)
            self._sent_ms = now_ms
        return ticks.IDLE_MS

    def _inhibited_ms(self, now_ms):
        if self._sent_ms is None:
            return 0
        elapsed_ms = ticks.diff(now_ms, self._sent_ms)
        return self._inhibit_ms - elapsed_ms if 0 <= elapsed_ms < self._inhibit_ms else 0

    def _post(self, source, code, detail):
        if len(self.queue) == _QUEUE_SIZE:
            self.queue.pop(0)
        self.queue.append(bytes((code & 0xFF, code >> 8, self.register(), source)) + detail)

    def _remember(self, error):
        objects = self._objects
        count = min(objects.number(indices.ERROR_HISTORY) + 1, _HISTORY_SIZE)
        for sub in range(count, 1, -1):
            objects.put(indices.ERROR_HISTORY, sub, objects.number(indices.ERROR_HISTORY, sub - 1))
        objects.put(indices.ERROR_HISTORY, 1, error)
        objects.put(indices.ERROR_HISTORY, 0, count)

    def _check_history(self, sub):
        """Raises AbortError if there is no error of this age."""
        if sub > self._objects.number(indices.ERROR_HISTORY):
            raise sdo.AbortError(sdo.NO_DATA)

    def _clear_history(self, number):
        if number:
            raise sdo.AbortError(sdo.INVALID_VALUE)
        for sub in range(_HISTORY_SIZE + 1):
            self._objects.put(indices.ERROR_HISTORY, sub, 0)

    def _on_cob_id(self, index, _sub):
        check_cob_id(self._objects.number(index), self.can_id)
        self.load()

    def _on_inhibit_time(self, _index, _sub):
        self.load()
