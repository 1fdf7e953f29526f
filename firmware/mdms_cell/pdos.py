"""All PDOs of a cell, alive in 'operational' only."""

from mdms_cell.rpdo import Rpdo
from mdms_cell.tpdo import Tpdo

COUNT = 4


class Pdos:
    """Receive and transmit PDOs; those in `timed` want `poll_timed` every millisecond.

    `clock()` tells the time [ms], `changed()` is told of other identifiers.
    """

    def __init__(self, objects, clock, send, changed):
        self._rpdos = [Rpdo(number, objects, changed) for number in range(COUNT)]
        self._tpdos = [Tpdo(number, objects, send, changed) for number in range(COUNT)]
        self._alive = False
        self._clock = clock
        self.choose()

    def load(self):
        """Take over everything from the dictionary."""
        for pdo in self._rpdos + self._tpdos:
            pdo.load()
        self.choose()

    def choose(self):
        """Find again which PDOs are in use."""
        self._received = [rpdo for rpdo in self._rpdos if rpdo.can_id is not None]
        self._sent = [tpdo for tpdo in self._tpdos if tpdo.can_id is not None]
        self.timed = [tpdo for tpdo in self._sent if tpdo.timed]

    def start(self, now_ms):
        """The cell is 'operational' now."""
        self._alive = True
        for pdo in self._rpdos + self._tpdos:
            pdo.start()
        self.poll(now_ms)

    def stop(self):
        """The cell is not 'operational' any more."""
        self._alive = False

    def receivers(self):
        """Pairs of an identifier and what takes its frames."""
        for can_id in {rpdo.can_id for rpdo in self._received}:
            same = [rpdo for rpdo in self._received if rpdo.can_id == can_id]
            yield can_id, self._receiver(same)

    def _receiver(self, rpdos):
        def receive(data):
            taken = True
            if self._alive:
                now_ms = self._clock()
                for rpdo in rpdos:
                    taken = rpdo.on_frame(data, now_ms) and taken
            return taken

        return receive

    def on_sync(self):
        """SYNC: take over what is held, and send."""
        if self._alive:
            for rpdo in self._received:
                rpdo.on_sync()
            for tpdo in self._sent:
                tpdo.on_sync()

    def poll_timed(self, now_ms):
        """Send what has an event timer, which counts milliseconds."""
        if self._alive:
            for tpdo in self.timed:
                tpdo.poll(now_ms)

    def poll(self, now_ms):
        """Send what has changed; return whether a frame that was waited for has not come."""
        overdue = False
        if self._alive:
            for tpdo in self._sent:
                tpdo.poll(now_ms)
            for rpdo in self._received:
                overdue = rpdo.overdue(now_ms) or overdue
        return overdue
