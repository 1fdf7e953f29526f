"""Settings that outlive the power supply (CiA 301, 7.5.2.13 and 7.5.2.14: 0x1010 and 0x1011).

A save goes to the bank of the memory that is not in use. It counts only when all of it is there.
So power may fail at any byte, and the save before stays valid.

The memory has `read(bank)`, which returns the whole bank, `erase(bank)` and
`write(bank, offset, data)`. It raises OSError where it fails.

Between a save and a start the firmware may have been updated. A saved value belongs to an entry of
the same index, sub-index and type. An object whose meaning or unit changes gets another index. A
value is not taken if it has no entry, lies out of today's limits, or would make a PDO that no
client could make. Then the entry has its default, and the value is a misfit to be reported.
"""

from mdms_cell.canopen import rules
from mdms_cell.canopen.objects import find
from mdms_cell.canopen.storage import saved
from mdms_protocol import indices, record
from mdms_protocol.codecs import cob, sdo

SOURCE_SETTINGS = 8
SETTINGS_LOST = 0x6310


_SAVE = 0x65766173
_LOAD = 0x64616F6C
#: The flags of the entries that each sub-index stands for.
_GROUPS = {
    1: record.STORED_COMMUNICATION | record.STORED_APPLICATION,
    2: record.STORED_COMMUNICATION,
    3: record.STORED_APPLICATION,
}
#: The value of a read: saved on command, not by itself; defaults can be restored.
_ON_COMMAND = 1
_PDOS = (
    (indices.RPDO_PARAMETERS, indices.RPDO_MAPPING, record.IN_RPDO),
    (indices.TPDO_PARAMETERS, indices.TPDO_MAPPING, record.IN_TPDO),
)
_STORED = record.STORED_COMMUNICATION | record.STORED_APPLICATION


class Store:
    """The saved settings; without a memory (None) nothing is saved and saving is refused."""

    def __init__(self, memory):
        self._memory = memory
        self._bank = 0
        self._sequence = 0
        self._values = b""
        if memory is not None:
            self._bank, self._sequence, self._values = saved.newest(memory)

    def node_id(self):
        """The saved node id, or None."""
        return saved.node_id_of(self._values)

    def restore(self, objects, flags):
        """Give the entries that have one of these flags their saved values.

        Returns (index, sub-index) of the saved values that were not taken.
        """
        return _restore(self._values, objects, flags)

    def save(self, objects, flags):
        """Save the entries that have one of these flags; raises AbortError."""
        self._write(saved.without(self._values, flags) + saved.of(objects, flags))

    def drop(self, flags):
        """Give up the saved values of these entries; raises AbortError."""
        self._write(saved.without(self._values, flags))

    def save_node_id(self, node_id):
        """Save the node id; raises AbortError."""
        self._write(saved.with_node_id(self._values, node_id))

    def _write(self, values):
        if self._memory is None:
            raise sdo.AbortError(sdo.CANNOT_STORE)
        saved.write(self._memory, 1 - self._bank, self._sequence + 1, values)
        self._bank = 1 - self._bank
        self._sequence += 1
        self._values = values


class Parameters:
    """Ties 0x1010 and 0x1011 to the store; `driving()` returns whether motors are on.

    Erasing flash stops the processor, so nothing is stored while they are. Saved values that do not
    fit are reported to `emcy`, with the first of them and their number, until they are given up.
    """

    def __init__(self, objects, store, driving, emcy):
        self._objects = objects
        self._store = store
        self._driving = driving
        self._emcy = emcy
        self._misfits = []
        objects.watch(self._on_store, indices.STORE)
        objects.watch(self._on_restore, indices.RESTORE)

    def restore(self, flags):
        """Give the entries that have one of these flags their saved values."""
        self._misfits = self._store.restore(self._objects, flags)
        self._report()

    def _report(self):
        if not self._misfits:
            self._emcy.clear(SOURCE_SETTINGS)
            return
        index, sub = self._misfits[0]
        detail = bytes((index & 0xFF, index >> 8, sub, min(len(self._misfits), 0xFF)))
        self._emcy.report(SOURCE_SETTINGS, SETTINGS_LOST, detail)

    def _on_store(self, index, sub):
        self._take(index, sub, _SAVE)
        self._store.save(self._objects, _GROUPS[sub])
        self._give_up(_GROUPS[sub])

    def _on_restore(self, index, sub):
        self._take(index, sub, _LOAD)
        self._store.drop(_GROUPS[sub])
        self._give_up(_GROUPS[sub])

    def _give_up(self, flags):
        """Saved values with these flags, and those of no entry, are there no more."""
        self._misfits = _remaining(self._misfits, flags)
        self._report()

    def _take(self, index, sub, expected):
        signature = self._objects.number(index, sub)
        self._objects.put(index, sub, _ON_COMMAND)
        if signature != expected:
            raise sdo.AbortError(sdo.CANNOT_STORE)
        if self._driving():
            raise sdo.AbortError(sdo.WRONG_STATE)


def _restore(values, objects, flags):
    """Give the entries that have one of these flags their saved values.

    Returns (index, sub-index) of all that was not taken, whatever its flags; where values do not go
    together, that of the COB-ID.
    """
    misfits = []
    for index, sub, type_, value in saved.items(values):
        if index == saved.NODE_ID:
            continue
        entry = _home(index, sub, type_, value)
        if entry is None:
            misfits.append((index, sub))
        elif entry.flags & flags:
            objects.data[entry.place : entry.place + entry.size] = value
    for sub, places in _unsound(objects):
        for index in places:
            objects.restore_default(index)
        misfits.append((places[0], sub))
    return misfits


def _remaining(misfits, flags):
    """Those that are still among the saved values when entries with these flags were saved anew."""
    return [each for each in misfits if saved.outlives(each[0], each[1], flags)]


def _home(index, sub, type_, value):
    """The entry that a saved value belongs to, None if there is none that it fits."""
    try:
        entry = find(index, sub)
        if not entry.flags & _STORED or entry.type != type_ or entry.size != len(value):
            return None
        entry.check_bytes(value)
    except sdo.AbortError:
        return None
    return entry


def _unsound(objects):
    """Yield settings that no client could have written: sub-index of the COB-ID, and objects."""
    if not _allowed(rules.check_plain, objects.number(indices.SYNC_COB_ID)):
        yield 0, (indices.SYNC_COB_ID,)
    if not _allowed(rules.check_cob_id, objects.number(indices.EMCY_COB_ID), None):
        yield 0, (indices.EMCY_COB_ID,)
    for number in range(len(cob.TPDO_BASES)):
        for first_parameters, first_mapping, direction in _PDOS:
            parameters, mapping = first_parameters + number, first_mapping + number
            if not _allowed(rules.check_pdo, objects, parameters, mapping, direction):
                yield rules.COB_ID, (parameters, mapping)


def _allowed(check, *arguments):
    try:
        check(*arguments)
    except sdo.AbortError:
        return False
    return True
