"""What receive and transmit PDOs have in common: how they may be configured (CiA 301, 7.5.2.35-38).

The standard's procedure to change a PDO: make it invalid by bit 31 of its COB-ID, set the number of
mapped objects to 0, write the entries, set the number, make it valid.
"""

from mdms_cell.objects import find
from mdms_protocol import cob, record, sdo

COB_ID = 1
TYPE = 2
INHIBIT_TIME = 3
EVENT_TIMER = 5

#: Transmission types: 0 to 240 go with SYNC, the last two with events.
SYNCHRONOUS_MAX = 240
EVENT_MANUFACTURER = 254
EVENT_PROFILE = 255

_BITS_MAX = 64
#: Bits of the data types that a receive PDO may carry for others: CiA 301, 7.4.7.3, dummy mapping.
DUMMIES = {2: 8, 3: 16, 4: 32, 5: 8, 6: 16, 7: 32}


class Pdo:
    """One PDO; `direction` is the flag of the entries that it may carry.

    `changed(sub)` is told which of its parameters is another.
    """

    def __init__(self, objects, parameters, mapping, direction, changed):
        self._objects = objects
        self._parameters = parameters
        self._mapping = mapping
        self._direction = direction
        self._changed = changed
        self.can_id = None
        objects.watchers[parameters] = self._on_parameter
        objects.watchers[mapping] = self._on_mapping

    def load(self):
        """Take over identifier and type from the dictionary."""
        cob_id = self._parameter(COB_ID)
        self.can_id = None if cob_id & cob.INVALID else cob_id & cob.IDENTIFIER
        self.type = self._parameter(TYPE)
        self.synchronous = self.type <= SYNCHRONOUS_MAX

    def entries(self):
        """What is mapped, as (index, sub-index, bits)."""
        return [self._entry(sub) for sub in range(1, self._count() + 1)]

    def _parameter(self, sub):
        return self._objects.number(self._parameters, sub)

    def _count(self):
        return self._objects.number(self._mapping, 0)

    def _entry(self, sub):
        """An entry of the mapping as (index, sub-index, bits)."""
        item = self._objects.number(self._mapping, sub)
        return item >> 16, item >> 8 & 0xFF, item & 0xFF

    def _on_parameter(self, _index, sub):
        if sub == COB_ID:
            self._check_cob_id()
        elif sub == TYPE and SYNCHRONOUS_MAX < self._parameter(TYPE) < EVENT_MANUFACTURER:
            raise sdo.AbortError(sdo.INVALID_VALUE)
        elif sub == INHIBIT_TIME and self.can_id is not None:
            raise sdo.AbortError(sdo.WRONG_STATE)
        self.load()
        self._changed(sub)

    def _check_cob_id(self):
        cob_id = self._parameter(COB_ID)
        can_id = cob_id & cob.IDENTIFIER
        if cob_id & cob.INVALID:
            return
        if cob_id & (cob.FLAG_30 - 1) != can_id or cob.restricted(can_id):
            raise sdo.AbortError(sdo.INVALID_VALUE)
        if self.can_id is not None and self.can_id != can_id:
            raise sdo.AbortError(sdo.WRONG_STATE)

    def _on_mapping(self, _index, sub):
        if self.can_id is not None:
            raise sdo.AbortError(sdo.WRONG_STATE)
        if sub == 0:
            self._check_total()
            self.load()
        elif self._count():
            raise sdo.AbortError(sdo.WRONG_STATE)
        else:
            self._check_entry(*self._entry(sub))

    def _check_total(self):
        bits = 0
        for sub in range(1, self._count() + 1):
            entry = self._entry(sub)
            self._check_entry(*entry)
            bits += entry[2]
        if bits > _BITS_MAX:
            raise sdo.AbortError(sdo.PDO_TOO_LONG)

    def _check_entry(self, index, sub, bits):
        if self._direction == record.IN_RPDO and index in DUMMIES and sub == 0:
            if DUMMIES[index] != bits:
                raise sdo.AbortError(sdo.NOT_MAPPABLE)
            return
        entry = find(index, sub)
        if not entry.flags & self._direction or entry.size * 8 != bits:
            raise sdo.AbortError(sdo.NOT_MAPPABLE)
