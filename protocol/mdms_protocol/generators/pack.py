"""Writes the object table as the three byte strings that a cell holds it in.

A record describes in eight bytes a run of entries that differ in nothing but their sub-indices, in
the order of (index, sub-index), so that a cell finds it by halving; the values of a run lie one
after the other from `place` on. Limits that several entries share stand once.
"""

import struct

from mdms_protocol import entry as e
from mdms_protocol.dictionary import OBJECTS
from mdms_protocol.record import (
    COUNT_SHIFT,
    FROM_NODE,
    IN_RPDO,
    IN_TPDO,
    LIMITS,
    READABLE,
    RECORD,
    RUN_MAX,
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
_MAPPABLE = {0: 0, e.RPDO: IN_RPDO, e.TPDO: IN_TPDO, e.BOTH: IN_RPDO | IN_TPDO}
_STORED = {None: 0, e.COMMUNICATION: STORED_COMMUNICATION, e.APPLICATION: STORED_APPLICATION}


def flags(entry: e.Entry) -> int:
    """The flags of an entry's record."""
    return (
        _ACCESS[entry.access]
        | _MAPPABLE[entry.mappable]
        | _STORED[entry.stored]
        | (FROM_NODE if entry.from_node else 0)
    )


def pack() -> tuple[bytes, bytes, bytes]:
    """All records, the limits that they refer to, and the defaults of all values."""
    records = b""
    data = b""
    limits: list[tuple[int, int]] = []
    for run in _runs():
        entry = run[0]
        records += struct.pack(
            RECORD,
            entry.index,
            entry.sub,
            entry.type.code | len(run) - 1 << COUNT_SHIFT,
            flags(entry),
            _number_of(limits, entry),
            len(data),
        )
        data += b"".join(default(each) for each in run)
    # One more place, so that the last value has an end too.
    records += struct.pack(RECORD, 0xFFFF, 0xFF, 0, 0, 0, len(data))
    return records, b"".join(struct.pack(LIMITS, *pair) for pair in limits), data


def _runs() -> list[list[e.Entry]]:
    """The entries in their order; those of one record are together."""
    runs: list[list[e.Entry]] = []
    for each in OBJECTS:
        for entry in each.entries:
            if runs and len(runs[-1]) < RUN_MAX and _follows(runs[-1][-1], entry):
                runs[-1].append(entry)
            else:
                runs.append([entry])
    return runs


def _follows(before: e.Entry, entry: e.Entry) -> bool:
    return (
        (before.index, before.sub + 1) == (entry.index, entry.sub)
        and (before.type, before.low, before.high) == (entry.type, entry.low, entry.high)
        and flags(before) == flags(entry)
    )


def _number_of(limits: list[tuple[int, int]], entry: e.Entry) -> int:
    """The number of an entry's limits, which join the list if they are new."""
    pair = (entry.low, entry.high)
    if pair == (entry.type.low, entry.type.high):
        return 0
    if pair not in limits:
        limits.append(pair)
    return limits.index(pair) + 1


def default(entry: e.Entry) -> bytes:
    """The default of an entry as it goes over the wire; of a domain, nothing."""
    if entry.type == e.TEXT:
        return bytes(entry.default.encode())
    if entry.type == e.DOMAIN:
        return b""
    size: int = entry.type.size
    return bytes((entry.default & (1 << 8 * size) - 1).to_bytes(size, "little"))
