"""The PDOs of a cell (CiA 301, 7.2.2; their configuration is 7.5.2.35 to 38), and their SYNC.

The standard has five steps to change a PDO. Make it invalid by bit 31 of its COB-ID. Set the number
of mapped objects to 0. Write the entries, then their number. Make the PDO valid.
"""

import struct

from mdms_cell import ticks
from mdms_cell.canopen.rules import (
    COB_ID,
    DUMMIES,
    EVENT_MANUFACTURER,
    EVENT_PROFILE,
    EVENT_TIMER,
    INHIBIT_TIME,
    SYNCHRONOUS_MAX,
    TYPE,
    check_mapping,
    check_parameter,
    mapped,
)
from mdms_protocol import indices, record
from mdms_protocol.codecs import cob, sdo
from mdms_protocol.compat import const, micropython

_DUMMY_FORMATS = {8: "B", 16: "H", 32: "I"}
_INHIBIT_UNITS_PER_MS = 10
#: Presence and statuswords: a poll follows when they change. All else may change at any time.
_ANNOUNCED = (
    indices.PRESENCE,
    indices.STATUSWORD,
    indices.STATUSWORD + indices.AXIS_OFFSET,
)


class Pdo:
    """One PDO; `direction` is the flag of the entries that it may carry.

    `changed(sub)` is called when that one of its parameters has changed.
    """

    def __init__(self, objects, parameters, mapping, direction, changed):
        self._objects = objects
        self._parameters = parameters
        self._mapping = mapping
        self._direction = direction
        self._changed = changed
        self.can_id = None
        objects.watch(self._on_parameter, parameters)
        objects.watch(self._on_mapping, mapping)

    def load(self):
        """Take over identifier and type from the dictionary."""
        cob_id = self._parameter(COB_ID)
        self.can_id = None if cob_id & cob.INVALID else cob_id & cob.IDENTIFIER
        self.type = self._parameter(TYPE)
        self.synchronous = self.type <= SYNCHRONOUS_MAX

    def entries(self):
        """The mapped entries, as (index, sub-index, bits)."""
        return [self._entry(sub) for sub in range(1, self._count() + 1)]

    def _parameter(self, sub):
        return self._objects.number(self._parameters, sub)

    def _count(self):
        return self._objects.number(self._mapping, 0)

    def _entry(self, sub):
        """An entry of the mapping as (index, sub-index, bits)."""
        return mapped(self._objects, self._mapping, sub)

    def _on_parameter(self, _index, sub):
        check_parameter(self._direction, sub, self._parameter(sub), self.can_id)
        self.load()
        self._changed(sub)

    def _on_mapping(self, _index, sub):
        if self.can_id is not None:
            raise sdo.AbortError(sdo.WRONG_STATE)
        entries = [self._entry(sub)] if sub else self.entries()
        check_mapping(entries, sub, self._count(), self._direction)
        if sub == 0:
            self.load()


class Rpdo(Pdo):
    """Receive PDO `number`, counted from 0.

    `attend()` returns the time [ms] and has a poll follow; see `Pdo` for `changed`.
    """

    def __init__(self, number, objects, attend, changed):
        parameters, mapping = indices.RPDO_PARAMETERS + number, indices.RPDO_MAPPING + number
        super().__init__(objects, parameters, mapping, record.IN_RPDO, changed)
        self._attend = attend
        self._received_ms = None
        #: The frame for the next SYNC.
        self.held = None
        self.late = False
        #: Whether the last frame was too short, and whether one was that is still to be reported.
        self.short = False
        self.was_short = False
        self.load()

    def load(self):
        """Take over everything from the dictionary."""
        super().load()
        self.held = None
        self._writes = []
        layout = "<"
        for index, sub, bits in self.entries():
            if index in DUMMIES:
                write, layout = None, layout + _DUMMY_FORMATS[bits]
            else:
                write, form = self._objects.writer(index, sub)
                layout += form[1]
            self._writes.append(write)
        self._layout = layout
        self._length = struct.calcsize(layout)
        self.deadline_ms = self._parameter(EVENT_TIMER)
        self._received_ms = None
        self.late = self.short = False

    def on_frame(self, data):
        """Take or hold the values; return False if the frame is too short for them."""
        if len(data) < self._length:
            self.short = self.was_short = True
            self._attend()
            return False
        if self.short:
            self.short = False
            self._attend()
        if self.deadline_ms:
            self._received_ms = self._attend()
            self.late = False
        if self.synchronous:
            self.held = data
        else:
            self._take(data)
        return True

    def on_sync(self):
        """Take over the held values."""
        held = self.held
        if held is not None:
            self.held = None
            self._take(held)

    def discard(self):
        """Drop the held values."""
        self.held = None

    def start(self):
        """Forget all frames from before 'operational'."""
        self.held = None
        self._received_ms = None
        self.late = False
        self.short = False
        self.was_short = False

    def take_short(self):
        """Whether a frame has come that is too short, since this was asked last."""
        was_short, self.was_short = self.was_short, False
        return was_short

    def overdue(self, now_ms):
        """Whether the frame that the event timer waits for has not come; True once."""
        if self._received_ms is None or self.wait_ms(now_ms) > 0:
            return False
        self._received_ms = None
        self.late = True
        return True

    def wait_ms(self, now_ms):
        """In how many milliseconds the frame will be overdue, unless it comes."""
        if self._received_ms is None:
            return ticks.IDLE_MS
        return self.deadline_ms - ticks.diff(now_ms, self._received_ms)

    def _take(self, data):
        values = struct.unpack_from(self._layout, data)
        for write, value in zip(self._writes, values):  # noqa: B905 - not in MicroPython
            if write is not None:
                write(value)


class Tpdo(Pdo):
    """Transmit PDO `number`, counted from 0.

    `on_sync` is for a synchronous PDO, `trigger` for type 254, and `poll` for type 255. See `Pdo`
    for `changed`. `refused` is the change for which there was no room at SYNC.
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
        """Send the mapped values; return False if there was no room."""
        return self._send(self.can_id, self._data())

    @micropython.native
    def poll(self, now_ms):
        """Send after a change or at the event timer, but not within the inhibit time.

        Returns in how many milliseconds to poll again, if no change is announced before.
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
        return struct.pack(self._layout, *values)


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
        """Take over held values at SYNC, and send; return False if the frame is no SYNC."""
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
        """Drop the values held for SYNC: they came before the state that has just begun."""
        for rpdo in self._held:
            rpdo.discard()

    @micropython.native
    def poll(self, now_ms):
        """Send changed values; return in how many milliseconds to poll again."""
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


# SYNC (7.2.5) -------------------------------------------------------------------------------------

#: Half beats without SYNC before a cell takes over, and before it returns after it has yielded.
MISSED_HALVES = 5
YIELDED_HALVES = 3
RANK_MS = 1
_WRAP = const((1 << 30) - 1)  # of the clock, see `ticks`


class Beat:
    """The common beat: when this cell is to send SYNC; off until it is configured and started.

    SYNC has no sender. Two nodes may never send one identifier with different data, so it can have
    none. But a cell can tell another's SYNC from its own:

    - A producer that sees another's SYNC yields. So the host's SYNC wins. If two beats meet after a
      partition has healed, the first SYNC wins.
    - A cell that misses SYNC for two beats and a half takes over, a millisecond later for each
      rank. So the next rank is silenced by it. Up to rank 22 the gap stays below 50 ms.
    - Two producers whose SYNCs cross on their way both yield. So a cell that has yielded, and has
      not seen two other beats in turn, returns after one beat and a half, the lower rank first.

    Two producers that begin at the same bit send one frame, and are one beat.

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
