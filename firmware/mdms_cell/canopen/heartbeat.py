"""Heartbeats: the producer (0x1017) and the consumer (0x1016) of CiA 301, 7.2.8.2.2.3."""

from mdms_cell import ticks
from mdms_protocol import indices
from mdms_protocol.codecs import cob, nmt, sdo
from mdms_protocol.compat import micropython

CONSUMED_NODES = 4


class Heartbeat:
    """Sends the cell's state at the period of 0x1017, which is 0 for never."""

    def __init__(self, objects, send):
        self._objects = objects
        self._send = send
        self._period_ms = 0
        self._due_ms = 0
        self._owed = False
        self.now_ms = 0
        objects.watch(self._configure, indices.PRODUCER_TIME)

    def start(self, now_ms):
        """Begin a period, at boot-up or when the period changed."""
        self._period_ms = self._objects.number(indices.PRODUCER_TIME)
        self._due_ms = ticks.after(now_ms, self._period_ms)

    def answer(self):
        """Have one more heartbeat sent, as soon as there is room."""
        self._owed = True

    @micropython.native
    def poll(self, now_ms, node_id, state):
        """Send a heartbeat if it is due; return in how many milliseconds the next one is.

        A late heartbeat does not delay the next ones.
        """
        self.now_ms = now_ms
        if self._owed:
            self._owed = not self._send(cob.HEARTBEAT_BASE + node_id, bytes((state,)))
        wait_ms = self._poll_period(now_ms, node_id, state)
        return min(wait_ms, ticks.RETRY_MS) if self._owed else wait_ms

    @micropython.native
    def _poll_period(self, now_ms, node_id, state):
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


class Consumer:
    """Watches the nodes that 0x1016 names, each from its first heartbeat on.

    `attend()` returns the time [ms] and has a poll follow; `changed()` is called when the
    identifiers have changed.
    """

    def __init__(self, objects, attend, changed):
        self._objects = objects
        self._changed = changed
        self._attend = attend
        objects.watch(self._on_time, indices.CONSUMER_TIMES)
        self.load()

    def load(self):
        """Take over what to watch from the dictionary; no node has been heard, and none is lost."""
        self._limits_ms = {}
        self._nodes = [0] * (CONSUMED_NODES + 1)  # by sub-index; 0 where none is watched
        self._received_ms = {}
        self.lost = set()
        for sub in range(1, CONSUMED_NODES + 1):
            self._take_entry(sub)

    def _take_entry(self, sub):
        """Begin to watch the node of one entry, in place of the node that it had."""
        before = self._nodes[sub]
        self._limits_ms.pop(before, None)
        self._received_ms.pop(before, None)
        self.lost.discard(before)
        node_id, limit_ms = self._watched(sub)
        watches = cob.NODE_MIN <= node_id <= cob.NODE_MAX and limit_ms
        self._nodes[sub] = node_id if watches else 0
        if watches:
            self._limits_ms[node_id] = limit_ms

    def receivers(self):
        """Pairs of an identifier and what takes its frames."""
        for node_id in self._limits_ms:
            yield cob.HEARTBEAT_BASE + node_id, self._receiver(node_id)

    def _receiver(self, node_id):
        def receive(data):
            if nmt.decode_heartbeat(data) is None:
                return False
            self._received_ms[node_id] = self._attend()
            self.lost.discard(node_id)
            return True

        return receive

    @property
    def host_lost(self):
        """Whether the host is watched, and has fallen silent."""
        return cob.HOST_NODE in self.lost

    def poll(self, now_ms):
        """Return the node that has fallen silent just now, 0 for none; `lost` are all that have."""
        for node_id, received_ms in self._received_ms.items():
            if ticks.diff(now_ms, received_ms) >= self._limits_ms[node_id]:
                del self._received_ms[node_id]
                self.lost.add(node_id)
                return node_id
        return 0

    def wait_ms(self, now_ms):
        """In how many milliseconds a node will have fallen silent, unless a heartbeat comes."""
        wait_ms = ticks.IDLE_MS
        for node_id, received_ms in self._received_ms.items():
            wait_ms = min(wait_ms, self._limits_ms[node_id] - ticks.diff(now_ms, received_ms))
        return wait_ms

    def _watched(self, sub):
        value = self._objects.number(indices.CONSUMER_TIMES, sub)
        return value >> 16, value & 0xFFFF

    def _on_time(self, _index, sub):
        node_id, limit_ms = self._watched(sub)
        for other in range(1, CONSUMED_NODES + 1):
            other_id, other_ms = self._watched(other)
            if other != sub and other_id == node_id and node_id and other_ms and limit_ms:
                raise sdo.AbortError(sdo.INCOMPATIBLE)
        self._take_entry(sub)
        self._changed()
