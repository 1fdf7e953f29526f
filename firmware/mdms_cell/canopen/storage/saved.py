"""Saved settings as bytes, and the way into the two banks of a memory.

A bank holds a header (see `_HEADER`), a CRC-32 and the values that differ from their defaults. Each
value has its index u16, sub-index u8, type and size u8, and bytes. The LSS node id is an entry of
index 0. Name and coding of an entry lie beside its value. So values outlive a table that grows or
shrinks, and `store` gives them back.
"""

import binascii
import struct

from mdms_cell.canopen.objects import find
from mdms_protocol import record
from mdms_protocol.codecs import cob, sdo

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

NODE_ID = 0
_NODE_ID_TYPE = 0x05  # UNSIGNED8
_STORED = record.STORED_COMMUNICATION | record.STORED_APPLICATION


def newest(memory):
    """Bank, sequence and values of the newer of the banks that are whole."""
    newest_bank, newest_sequence, values = 0, 0, b""
    for bank in (0, 1):
        found = _decode(memory.read(bank))
        if found is not None and found[0] > newest_sequence:
            newest_bank = bank
            newest_sequence, values = found
    return newest_bank, newest_sequence, values


def write(memory, bank, sequence, values):
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


def node_id_of(values):
    """The node id among saved values, or None."""
    for index, _, _, value in items(values):
        if index == NODE_ID:
            node_id = value[0]
            known = cob.NODE_MIN <= node_id <= cob.NODE_MAX or node_id == cob.NODE_NONE
            return node_id if known else None
    return None


def with_node_id(values, node_id):
    """Saved values with another node id."""
    others = [each for each in items(values) if each[0] != NODE_ID]
    others.insert(0, (NODE_ID, 0, _NODE_ID_TYPE, bytes((node_id,))))
    return b"".join(_item(*each) for each in others)


def without(values, flags):
    """Of saved values, those that a save of the entries with these flags leaves; see `outlives`."""
    return b"".join(_item(*each) for each in items(values) if outlives(each[0], each[1], flags))


def outlives(index, sub, flags):
    """Whether a saved value stays when entries with these flags are saved or given up.

    The node id does, and values of other groups. A value of no entry that is stored today has no
    group: until the next save it waits for the firmware that it came from, no longer.
    """
    if index == NODE_ID:
        return True
    try:
        group = find(index, sub).flags & _STORED
    except sdo.AbortError:
        return False
    return bool(group) and not group & flags


def of(objects, flags):
    """The values to save of the entries that have one of these flags."""
    return b"".join(_item(*each) for each in objects.changed(flags))


def items(values):
    """Yield the saved values, as (index, sub-index, type, bytes)."""
    at = 0
    while at < len(values):
        index, sub, kind = struct.unpack_from(_ITEM, values, at)
        at += _ITEM_SIZE
        size = kind & _SIZE
        yield index, sub, kind >> _TYPE_SHIFT, values[at : at + size]
        at += size


def _item(index, sub, type_, value):
    return struct.pack(_ITEM, index, sub, type_ << _TYPE_SHIFT | len(value)) + value


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
