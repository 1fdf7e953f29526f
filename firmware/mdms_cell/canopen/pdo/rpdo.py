"""Receive PDOs (CiA 301, 7.2.2.3): values taken over at once, or held until SYNC."""

import struct

from mdms_cell import ticks
from mdms_cell.canopen.pdo.base import Pdo
from mdms_cell.canopen.rules import DUMMIES, EVENT_TIMER
from mdms_protocol import indices, record

_DUMMY_FORMATS = {8: "B", 16: "H", 32: "I"}


class Rpdo(Pdo):
    """Receive PDO `number`, counted from 0.

    `attend()` returns the time [ms] and has a poll follow; see `Pdo` for `changed`.
    """

    def __init__(self, number, objects, attend, changed):
        parameters, mapping = indices.RPDO_PARAMETERS + number, indices.RPDO_MAPPING + number
        super().__init__(objects, parameters, mapping, record.IN_RPDO, changed)
        self._attend = attend
        self._received_ms = None
        #: What has come for the next SYNC.
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
        self.short = False

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
        """Take over what is held."""
        held = self.held
        if held is not None:
            self.held = None
            self._take(held)

    def discard(self):
        """Drop what is held."""
        self.held = None

    def start(self):
        """Forget what came before 'operational'."""
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
