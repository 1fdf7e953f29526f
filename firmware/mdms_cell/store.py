"""Settings that outlive the power supply, in two banks of a memory that the board lends.

A save goes to the bank that is not in use and counts only when all of it is there, so that power
may fail at any byte: what was saved before stays valid. A bank holds a header (see `_HEADER`) and
the values that differ from their defaults, each as index u16, sub-index u8, size u8 and the bytes
of the value. The LSS node id lies there as an entry of index 0.

The memory has `read(bank)`, which returns the whole bank, `erase(bank)` and
`write(bank, offset, data)`, and raises OSError where it fails.
"""

import binascii
import struct

from mdms_cell.objects import find
from mdms_protocol import packed, sdo

#: magic, sequence, table (CRC-32 of records and limits), length of values; then a CRC-32 of all.
_HEADER = "<IIII"
_HEADER_SIZE = 16
_CRC_SIZE = 4
_MAGIC = 0x534D444D
_ITEM = "<HBB"
_ITEM_SIZE = 4

_NODE_ID = 0


class Store:
    """The saved settings; without a memory (None) nothing is saved and saving is refused."""

    def __init__(self, memory):
        self._memory = memory
        self._bank = 0
        self._sequence = 0
        self._values = b""
        self._table = binascii.crc32(packed.LIMITS, binascii.crc32(packed.RECORDS))
        if memory is not None:
            self._load()

    def node_id(self):
        """The saved node id, or None."""
        for index, _, value in self._items():
            if index == _NODE_ID:
                return value[0]
        return None

    def restore(self, objects, flags):
        """Give the entries that have one of these flags their saved values."""
        for index, sub, value in self._items():
            if index != _NODE_ID:
                entry = find(index, sub)
                if entry.flags & flags:
                    objects.data[entry.place : entry.place + entry.size] = value

    def save(self, objects, flags):
        """Save the entries that have one of these flags; raises AbortError."""
        self._write(self._others(flags) + b"".join(_item(*each) for each in objects.changed(flags)))

    def forget(self, flags):
        """Give up the saved values of these entries; raises AbortError."""
        self._write(self._others(flags))

    def save_node_id(self, node_id):
        """Save the node id; raises AbortError."""
        self._write(_item(_NODE_ID, 0, bytes((node_id,))) + self._others(0, keep_node_id=False))

    def _others(self, flags, keep_node_id=True):
        """The items that have none of these flags."""
        kept = b""
        for index, sub, value in self._items():
            if keep_node_id if index == _NODE_ID else not find(index, sub).flags & flags:
                kept += _item(index, sub, value)
        return kept

    def _items(self):
        """What is saved, as (index, sub-index, bytes)."""
        at = 0
        while at < len(self._values):
            index, sub, size = struct.unpack_from(_ITEM, self._values, at)
            at += _ITEM_SIZE
            yield index, sub, self._values[at : at + size]
            at += size

    def _load(self):
        """Take the newer of the banks that are whole."""
        for bank in (0, 1):
            found = _decode(self._memory.read(bank))
            if found is not None and found[0] > self._sequence:
                self._bank = bank
                self._sequence, table, self._values = found
                # Of another table only the node id is sure to mean the same.
                if table != self._table:
                    node_id = self.node_id()
                    self._values = b"" if node_id is None else _item(0, 0, bytes((node_id,)))

    def _write(self, values):
        if self._memory is None:
            raise sdo.AbortError(sdo.CANNOT_STORE)
        bank = 1 - self._bank
        head = struct.pack(_HEADER, _MAGIC, self._sequence + 1, self._table, len(values))
        crc = binascii.crc32(head + values).to_bytes(_CRC_SIZE, "little")
        try:
            self._memory.erase(bank)
            self._memory.write(bank, 0, head + crc + values)
            written = _decode(self._memory.read(bank))
        except OSError:
            written = None
        if written is None or written[2] != values:
            raise sdo.AbortError(sdo.HARDWARE_ERROR)
        self._bank = bank
        self._sequence += 1
        self._values = values


def _decode(bank):
    """Sequence, table and values of a bank, None if it is not whole."""
    if len(bank) < _HEADER_SIZE + _CRC_SIZE:
        return None
    magic, sequence, table, length = struct.unpack_from(_HEADER, bank)
    start = _HEADER_SIZE + _CRC_SIZE
    if magic != _MAGIC or start + length > len(bank):
        return None
    values = bytes(bank[start : start + length])
    crc = int.from_bytes(bytes(bank[_HEADER_SIZE:start]), "little")
    if binascii.crc32(bytes(bank[:_HEADER_SIZE]) + values) != crc:
        return None
    return sequence, table, values


def _item(index, sub, value):
    return struct.pack(_ITEM, index, sub, len(value)) + value
