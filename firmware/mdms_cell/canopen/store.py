"""Settings that outlive the power supply (CiA 301, 7.5.2.13 and 7.5.2.14: 0x1010 and 0x1011).

A save goes to the bank of the memory that is not in use. It counts only when all of it is there.
So power may fail at any byte, and the save before stays valid.

The memory has `read(bank)`, which returns the whole bank, `erase(bank)` and
`write(bank, offset, data)`. It raises OSError where it fails.

A bank holds a header (see `_HEADER`), a CRC-32 and the values that differ from their defaults. Each
value has its index u16, sub-index u8, type and size u8, and bytes. The LSS node id is an entry of
index 0. Name and coding of an entry lie beside its value. So values outlive a table that grows or
shrinks.

Between a save and a start the firmware may have been updated. A saved value belongs to an entry of
the same index, sub-index and type. An object whose meaning or unit changes gets another index. A
value is not taken if it has no entry, lies out of today's limits, or would make a PDO that no
client could make. Then the entry has its default, and the value is a misfit to be reported.
"""

import binascii
import struct

from mdms_cell.canopen import rules
from mdms_cell.canopen.objects import find
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

#: magic, sequence, length of values; then a CRC-32 of all.
_HEADER = "<III"
_HEADER_SIZE = 12
_CRC_SIZE = 4
_MAGIC = 0x324D444D
#: The last byte has the type in its upper and the size in its lower half.
_ITEM = "<HBB"
_ITEM_SIZE = 4
_TYPE_SHIFT = 4
_SIZE = 15

#: The index of the node id of LSS among the values.
_NODE_ID = 0
_NODE_ID_TYPE = 0x05  # UNSIGNED8


class Store:
    """The saved settings; without a memory (None) nothing is saved and saving is refused."""

    def __init__(self, memory):
        self._memory = memory
        self._bank = 0
        self._sequence = 0
        self._values = b""
        if memory is not None:
            self._bank, self._sequence, self._values = _newest(memory)

    def node_id(self):
        """The saved node id, or None."""
        for index, _, _, value in _items(self._values):
            if index == _NODE_ID:
                node_id = value[0]
                known = cob.NODE_MIN <= node_id <= cob.NODE_MAX or node_id == cob.NODE_NONE
                return node_id if known else None
        return None

    def restore(self, objects, flags):
        """Give the entries that have one of these flags their saved values.

        Returns (index, sub-index) of the saved values that were not taken.
        """
        return _restore(self._values, objects, flags)

    def save(self, objects, flags):
        """Save the entries that have one of these flags; raises AbortError."""
        self._write(_without(self._values, flags) + _joined(objects.changed(flags)))

    def drop(self, flags):
        """Give up the saved values of these entries; raises AbortError."""
        self._write(_without(self._values, flags))

    def save_node_id(self, node_id):
        """Save the node id; raises AbortError."""
        values = [each for each in _items(self._values) if each[0] != _NODE_ID]
        values.insert(0, (_NODE_ID, 0, _NODE_ID_TYPE, bytes((node_id,))))
        self._write(_joined(values))

    def _write(self, values):
        if self._memory is None:
            raise sdo.AbortError(sdo.CANNOT_STORE)
        write_bank(self._memory, 1 - self._bank, self._sequence + 1, values)
        self._bank = 1 - self._bank
        self._sequence += 1
        self._values = values


class Parameters:
    """Ties 0x1010 and 0x1011 to the store; `driving()` is whether motors are on, or brake still.

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
        self._misfits = [each for each in self._misfits if _outlives(*each, flags)]
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
    for index, sub, type_, value in _items(values):
        if index == _NODE_ID:
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


def _newest(memory):
    """Bank, sequence and values of the newer of the banks that are whole."""
    newest_bank, newest_sequence, values = 0, 0, b""
    for bank in (0, 1):
        found = _decode(memory.read(bank))
        if found is not None and found[0] > newest_sequence:
            newest_bank = bank
            newest_sequence, values = found
    return newest_bank, newest_sequence, values


def write_bank(memory, bank, sequence, values):
    """Write a bank and read it again; raises AbortError."""
    head = struct.pack(_HEADER, _MAGIC, sequence, len(values))
    crc = binascii.crc32(head + values).to_bytes(_CRC_SIZE, "little")
    try:
        memory.erase(bank)
        memory.write(bank, 0, head + crc + values)
        written = _decode(memory.read(bank))
    except OSError:
        written = None
    if written is None or written[1] != values:
        raise sdo.AbortError(sdo.HARDWARE_ERROR)


def _without(values, flags):
    """The values that a save of the entries with these flags leaves; see `_outlives`."""
    return _joined(each for each in _items(values) if _outlives(each[0], each[1], flags))


def _outlives(index, sub, flags):
    """Whether a saved value stays when entries with these flags are saved or given up.

    The node id does, and values of other groups. A value of no entry that is stored today has no
    group: until the next save it waits for the firmware that it came from, no longer.
    """
    if index == _NODE_ID:
        return True
    try:
        group = find(index, sub).flags & _STORED
    except sdo.AbortError:
        return False
    return bool(group) and not group & flags


def _items(values):
    """Yield the saved values, as (index, sub-index, type, bytes)."""
    at = 0
    while at < len(values):
        index, sub, kind = struct.unpack_from(_ITEM, values, at)
        at += _ITEM_SIZE
        size = kind & _SIZE
        yield index, sub, kind >> _TYPE_SHIFT, values[at : at + size]
        at += size


def _joined(items):
    """Those values as bytes again."""
    return b"".join(
        struct.pack(_ITEM, index, sub, type_ << _TYPE_SHIFT | len(value)) + value
        for index, sub, type_, value in items
    )


def _decode(bank):
    """Sequence and values of a bank, None if it is not whole."""
    if len(bank) < _HEADER_SIZE + _CRC_SIZE:
        return None
    magic, sequence, length = struct.unpack_from(_HEADER, bank)
    start = _HEADER_SIZE + _CRC_SIZE
    if magic != _MAGIC or start + length > len(bank):
        return None
    values = bytes(bank[start : start + length])
    crc = int.from_bytes(bytes(bank[_HEADER_SIZE:start]), "little")
    if binascii.crc32(bytes(bank[:_HEADER_SIZE]) + values) != crc:
        return None
    return sequence, values
