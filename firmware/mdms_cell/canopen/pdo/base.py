"""What receive and transmit PDOs have in common: how they may be configured (CiA 301, 7.5.2.35-38).

The standard's procedure to change a PDO: make it invalid by bit 31 of its COB-ID, set the number of
mapped objects to 0, write the entries, set the number, make it valid.
"""

from mdms_cell.canopen.rules import (
    COB_ID,
    SYNCHRONOUS_MAX,
    TYPE,
    check_mapping,
    check_parameter,
    mapped,
)
from mdms_protocol.codecs import cob, sdo


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
        objects.watch(parameters, self._on_parameter)
        objects.watch(mapping, self._on_mapping)

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
