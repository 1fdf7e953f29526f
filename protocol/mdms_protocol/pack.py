"""Writes the object table as the two byte strings that a cell holds it in.

A record tells an entry in 16 bytes, in the order of (index, sub-index), so that a cell finds it by
halving; its value lies at `place` in the data.
"""

import struct

from mdms_protocol import entry as e
from mdms_protocol.dictionary import OBJECTS
from mdms_protocol.record import (
    FROM_NODE,
    IN_RPDO,
    IN_TPDO,
    LIMITED,
    READABLE,
    RECORD,
    STORED_APPLICATION,
    STORED_COMMUNICATION,
    WRITABLE,
)

_ACCESS = {
    e.CONST: READABLE,
    e.READ: READABLE,
    e.WRITE: WRITABLE,
    e.READ_WRITE: READABLE | WRITABLE,
}
_MAPPABLE = {0: 0, e.RPDO: IN_RPDO, e.TPDO: IN_TPDO}
_STORED = {None: 0, e.COMMUNICATION: STORED_COMMUNICATION, e.APPLICATION: STORED_APPLICATION}


def flags(entry: e.Entry) -> int:
    """The flags of an entry's record."""
    limited = (entry.low, entry.high) != (entry.type.low, entry.type.high)
    return (
        _ACCESS[entry.access]
        | _MAPPABLE[entry.mappable]
        | _STORED[entry.stored]
        | (FROM_NODE if entry.from_node else 0)
        | (LIMITED if limited else 0)
    )


def pack() -> tuple[bytes, bytes]:
    """All records, and the defaults of all values."""
    records = b""
    data = b""
    for each in OBJECTS:
        for entry in each.entries:
            value = default(entry)
            low, high = (entry.low, entry.high) if flags(entry) & LIMITED else (0, 0)
            records += struct.pack(
                RECORD,
                entry.index,
                entry.sub,
                entry.type.code,
                flags(entry),
                len(value),
                len(data),
                low,
                high,
            )
            data += value
    return records, data


def default(entry: e.Entry) -> bytes:
    """The default of an entry as it goes over the wire; of a domain, nothing."""
    if entry.type == e.TEXT:
        return bytes(entry.default.encode())
    size: int = entry.type.size
    return bytes((entry.default & (1 << 8 * size) - 1).to_bytes(size, "little"))
