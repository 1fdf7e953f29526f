"""Process data objects (CiA 301, 7.2.2): what they carry, when they are taken over and sent."""

import struct

from mdms_cell.objects import find, key
from mdms_protocol import cob

RPDO_PARAMETERS = 0x1400
RPDO_MAPPING = 0x1600
TPDO_PARAMETERS = 0x1800
TPDO_MAPPING = 0x1A00
COUNT = 4

_COB_ID = 1
_TYPE = 2

SYNCHRONOUS_MAX = 240


def _mapping(objects, index):
    """The entries that a mapping object lists, as (index, sub-index)."""
    items = [objects.number(index, sub) for sub in range(1, objects.number(index, 0) + 1)]
    return [(item >> 16, item >> 8 & 0xFF) for item in items]


class Rpdo:
    """One receive PDO; a synchronous one is held until SYNC."""

    def __init__(self, number, objects):
        self._objects = objects
        self._number = number
        self.configure()

    def configure(self):
        """Take over identifier, type and mapping from the dictionary."""
        objects = self._objects
        parameters = RPDO_PARAMETERS + self._number
        cob_id = objects.number(parameters, _COB_ID)
        self.can_id = None if cob_id & cob.INVALID else cob_id & cob.IDENTIFIER
        self._synchronous = objects.number(parameters, _TYPE) <= SYNCHRONOUS_MAX
        entries = _mapping(objects, RPDO_MAPPING + self._number)
        self._format = "<" + "".join([find(*entry).format[1] for entry in entries])
        self._length = struct.calcsize(self._format)
        self._writes = [objects.writes[key(*entry)] for entry in entries]
        self._held = None

    def on_frame(self, data):
        """Take or hold the values; return False if the frame is too short for them."""
        if len(data) < self._length:
            return False
        if self._synchronous:
            self._held = data
        else:
            self._take(data)
        return True

    def on_sync(self):
        """Take over what is held."""
        if self._held is not None:
            self._take(self._held)
            self._held = None

    def drop(self):
        """Forget what is held."""
        self._held = None

    def _take(self, data):
        values = struct.unpack_from(self._format, data)
        for write, value in zip(self._writes, values):  # noqa: B905 - not in MicroPython
            write(value)


class Tpdo:
    """One transmit PDO."""

    def __init__(self, number, objects, send):
        self._objects = objects
        self._number = number
        self._send = send
        self.configure()

    def configure(self):
        """Take over identifier, type and mapping from the dictionary."""
        objects = self._objects
        parameters = TPDO_PARAMETERS + self._number
        cob_id = objects.number(parameters, _COB_ID)
        self.can_id = None if cob_id & cob.INVALID else cob_id & cob.IDENTIFIER
        self.synchronous = objects.number(parameters, _TYPE) <= SYNCHRONOUS_MAX
        entries = _mapping(objects, TPDO_MAPPING + self._number)
        self._format = "<" + "".join([find(*entry).format[1] for entry in entries])
        self._reads = [objects.reads[key(*entry)] for entry in entries]
        self._sent = None

    def send(self):
        """Send the values as they are now."""
        self._sent = struct.pack(self._format, *[read() for read in self._reads])
        self._send(self.can_id, self._sent)

    def send_if_changed(self):
        """Send the values if they are not those that were sent last."""
        data = struct.pack(self._format, *[read() for read in self._reads])
        if data != self._sent and self._send(self.can_id, data):
            self._sent = data

    def forget(self):
        """Let the next `send_if_changed` send."""
        self._sent = None
