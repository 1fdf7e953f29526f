"""All PDOs of a cell, alive in 'operational' only."""

from mdms_cell import ticks
from mdms_cell.canopen.pdo.rpdo import Rpdo
from mdms_cell.canopen.pdo.tpdo import Tpdo
from mdms_cell.canopen.rules import COB_ID, EVENT_MANUFACTURER, EVENT_PROFILE
from mdms_protocol.codecs import cob
from mdms_protocol.compat import micropython


class Pdos:
    """Receive and transmit PDOs.

    `attend()` returns the time [ms] and has a poll follow; `changed()` is called when the
    identifiers have changed.
    """

    def __init__(self, objects, attend, send, changed):
        self._attend = attend
        self._changed = changed
        numbers = range(len(cob.TPDO_BASES))
        on_change = self._on_change
        self._rpdos = [Rpdo(number, objects, attend, on_change) for number in numbers]
        self._tpdos = [Tpdo(number, objects, send, on_change) for number in numbers]
        self._alive = False
        self._choose()

    def load(self):
        """Take over everything from the dictionary."""
        for pdo in self._rpdos + self._tpdos:
            pdo.load()
        self._choose()

    def _choose(self):
        """Find again which PDOs are in use, and what for."""
        self._received = [rpdo for rpdo in self._rpdos if rpdo.can_id is not None]
        self._held = [rpdo for rpdo in self._received if rpdo.synchronous]
        self._awaited = [rpdo for rpdo in self._received if rpdo.deadline_ms]
        sent = [tpdo for tpdo in self._tpdos if tpdo.can_id is not None]
        self._sampled = [tpdo for tpdo in sent if tpdo.synchronous]
        self._spontaneous = [tpdo for tpdo in sent if tpdo.type == EVENT_PROFILE]
        self._triggered = [tpdo.type == EVENT_MANUFACTURER and tpdo in sent for tpdo in self._tpdos]

    def _on_change(self, sub):
        self._choose()
        if sub == COB_ID:
            self._changed()

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
        identifiers = {rpdo.can_id for rpdo in self._received}
        for can_id in identifiers:
            same = [rpdo for rpdo in self._received if rpdo.can_id == can_id]
            yield can_id, self._receiver(same)

    def _receiver(self, rpdos):
        def receive(data):
            taken = True
            if self._alive:
                for rpdo in rpdos:
                    taken = rpdo.on_frame(data) and taken
            return taken

        return receive

    @micropython.native
    def on_sync(self, data):
        """SYNC: take over what is held, and send; return False if it is none."""
        if len(data) > 1:
            return False
        if self._alive:
            for rpdo in self._held:
                if rpdo.held is not None:
                    rpdo.on_sync()
            for tpdo in self._sampled:
                if not tpdo.on_sync():
                    self._attend()
        return True

    @micropython.native
    def trigger(self, number):
        """Send transmit PDO `number`, counted from 0, as it is now; return whether it was sent.

        Nothing is sent unless its type, 254, leaves it to the caller and the cell is 'operational'.
        """
        if not self._alive or not self._triggered[number]:
            return False
        return self._tpdos[number].trigger()

    def discard_held(self):
        """Drop what is held for SYNC: it came before the state that has just begun."""
        for rpdo in self._held:
            rpdo.discard()

    @micropython.native
    def poll(self, now_ms):
        """Send what has changed; return in how many milliseconds to poll again."""
        wait_ms = ticks.IDLE_MS
        if self._alive:
            for tpdo in self._spontaneous:
                wait_ms = min(wait_ms, tpdo.poll(now_ms))
            for tpdo in self._sampled:
                if tpdo.refused is not None and not tpdo.retry():
                    wait_ms = min(wait_ms, ticks.RETRY_MS)
            for rpdo in self._awaited:
                wait_ms = min(wait_ms, rpdo.wait_ms(now_ms))
        return wait_ms

    @micropython.native
    def late(self):
        """Whether a frame that is waited for has still not come."""
        for rpdo in self._awaited:  # noqa: SIM110 - no generator
            if rpdo.late:
                return True
        return False

    @micropython.native
    def short(self):
        """Whether the last frame of an RPDO was too short for it."""
        for rpdo in self._received:  # noqa: SIM110 - no generator
            if rpdo.short:
                return True
        return False

    @micropython.native
    def take_short(self):
        """Whether a frame too short for its RPDO has come, since this was asked last."""
        short = False
        for rpdo in self._received:
            if rpdo.was_short:
                short = rpdo.take_short()
        return short

    def overdue(self, now_ms):
        """Whether a frame that was waited for has not come; True once."""
        overdue = False
        if self._alive:
            for rpdo in self._awaited:
                overdue = rpdo.overdue(now_ms) or overdue
        return overdue
