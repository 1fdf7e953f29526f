"""Defaults of the entries, looked at when a cell starts and when it saves."""

from mdms_cell.objects import entries
from mdms_protocol import packed, record


def blank():
    """Values for all entries, at the defaults of no node."""
    return bytearray(packed.DEFAULTS)


def reset(data, node_id, flags):
    """Give the entries that have one of these flags the defaults that they have at a node."""
    for entry in entries(flags):
        data[entry.place : entry.place + entry.size] = _default(entry, node_id)


def changed(data, node_id, flags):
    """What of these entries is not at its default, as (index, sub-index, bytes)."""
    for entry in entries(flags):
        value = bytes(data[entry.place : entry.place + entry.size])
        if value != _default(entry, node_id):
            yield entry.index, entry.sub, value


def _default(entry, node_id):
    value = packed.DEFAULTS[entry.place : entry.place + entry.size]
    if entry.flags & record.FROM_NODE:
        return (int.from_bytes(value, "little") + node_id).to_bytes(entry.size, "little")
    return value
