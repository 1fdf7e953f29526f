"""Heartbeat consumer (CiA 301, 7.2.8.2.2.3, 0x1016): notices when another node falls silent."""

from mdms_cell import ticks
from mdms_protocol import cob, sdo

TIMES = 0x1016
COUNT = 4


class Consumer:
    """Watches the nodes that 0x1016 names, each from its first heartbeat on."""

    def __init__(self, objects, changed):
        self._objects = objects
        self._changed = changed
        objects.watchers[TIMES] = self._on_time
        self.load()

    def load(self):
        """Take over what to watch from the dictionary."""
        self._limits_ms = {}
        for sub in range(1, COUNT + 1):
            node_id, limit_ms = self._watched(sub)
            if cob.NODE_MIN <= node_id <= cob.NODE_MAX and limit_ms:
                self._limits_ms[node_id] = limit_ms
        self._heard_ms = {}
        self.lost = []

    def identifiers(self):
        """The identifiers of the heartbeats that are watched."""
        return [cob.HEARTBEAT_BASE + node_id for node_id in self._limits_ms]

    def on_heartbeat(self, node_id, now_ms):
        """A watched node lives; return whether it had been lost."""
        self._heard_ms[node_id] = now_ms
        if node_id in self.lost:
            self.lost.remove(node_id)
            return True
        return False

    def poll(self, now_ms):
        """The node that has fallen silent just now, or None."""
        for node_id, heard_ms in self._heard_ms.items():
            if ticks.diff(now_ms, heard_ms) >= self._limits_ms[node_id]:
                del self._heard_ms[node_id]
                self.lost.append(node_id)
                return node_id
        return None

    def _watched(self, sub):
        value = self._objects.number(TIMES, sub)
        return value >> 16, value & 0xFFFF

    def _on_time(self, _index, sub):
        node_id, limit_ms = self._watched(sub)
        for other in range(1, COUNT + 1):
            if other != sub and limit_ms and self._watched(other)[0] == node_id and node_id:
                raise sdo.AbortError(sdo.INCOMPATIBLE)
        self.load()
        self._changed()
