"""Saved settings as bytes, and how they get into the two banks of a memory.

A bank holds a header (see `_HEADER`), a CRC-32 and the values that differ from their defaults, each
as index u16, sub-index u8, size u8 and the bytes of the value. The LSS node id lies there as an
entry of index 0.
"""

import binascii
import struct

from mdms_cell.canopen.objects import find
from mdms_protocol import packed, sdo

#: magic, sequence, table (CRC-32 of records and limits), length of values; then a CRC-32 of all.
_HEADER = "<IIII"
_HEADER_SIZE = 16
_CRC_SIZE = 4
_MAGIC = 0x534D444D
_ITEM = "<HBB"
_ITEM_SIZE = 4

_NODE_ID = 0


def newest(memory):
    """Bank, sequence and values of the newer of the banks that are whole."""
    newest_bank, newest_sequence, values = 0, 0, b""
    for bank in (0, 1):
        found = _decode(memory.read(bank))
        if found is not None and found[0] > newest_sequence:
            newest_bank = bank
            newest_sequence, table, values = found
            # Of another table only the node id is sure to mean the same.
            if table != _table():
                node_id = node_id_of(values)
                values = b"" if node_id is None else _item(_NODE_ID, 0, bytes((node_id,)))
    return newest_bank, newest_sequence, values


def write(memory, bank, sequence, values):
    """Write a bank and read it again; raises AbortError."""
    head = struct.pack(_HEADER, _MAGIC, sequence, _table(), len(values))
    crc = binascii.crc32(head + values).to_bytes(_CRC_SIZE, "little")
    try:
        memory.erase(bank)
        memory.write(bank, 0, head + crc + values)
        written = _decode(memory.read(bank))
    except OSError:
        written = None
    if written is None or written[2] != values:
        raise sdo.AbortError(sdo.HARDWARE_ERROR)


def node_id_of(values):
    """The node id among saved values, or None."""
    for index, _, value in _items(values):
        if index == _NODE_ID:
            return value[0]
    return None


def with_node_id(values, node_id):
    """Saved values with another node id."""
    return _item(_NODE_ID, 0, bytes((node_id,))) + without(values, 0, keep_node_id=False)


def without(values, flags, keep_node_id=True):
    """Of saved values, those whose entries have none of these flags."""
    kept = b""
    for index, sub, value in _items(values):
        if keep_node_id if index == _NODE_ID else not find(index, sub).flags & flags:
            kept += _item(index, sub, value)
    return kept


def of(objects, flags):
    """The values to save of the entries that have one of these flags."""
    return b"".join(_item(*each) for each in objects.changed(flags))


def restore(values, objects, flags):
    """Give the entries that have one of these flags their saved values."""
    for index, sub, value in _items(values):
        if index != _NODE_ID:
            entry = find(index, sub)
            if entry.flags & flags:
                objects.data[entry.place : entry.place + entry.size] = value


def _items(values):
    """What is saved, as (index, sub-index, bytes)."""
    at = 0
    while at < len(values):
        index, sub, size = struct.unpack_from(_ITEM, values, at)
        at += _ITEM_SIZE
        yield index, sub, values[at : at + size]
        at += size


def _item(index, sub, value):
    return struct.pack(_ITEM, index, sub, len(value)) + value


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


def _table():
    return binascii.crc32(packed.LIMITS, binascii.crc32(packed.RECORDS))
