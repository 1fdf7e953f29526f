"""Gives saved values back to the dictionary where they still fit the table of today.

Between a save and a start the firmware may have been updated. A saved value belongs to an entry of
the same index, sub-index and type; an object whose meaning or unit changes gets another index. What
belongs to no entry, lies out of today's limits, or would make a PDO that no client could make is
not taken: the entry has its default, and the value is a misfit to be reported.
"""

from mdms_cell.canopen import rules
from mdms_cell.canopen.objects import find
from mdms_cell.canopen.storage import saved
from mdms_protocol import indices, record
from mdms_protocol.codecs import cob, sdo

_PDOS = (
    (indices.RPDO_PARAMETERS, indices.RPDO_MAPPING, record.IN_RPDO),
    (indices.TPDO_PARAMETERS, indices.TPDO_MAPPING, record.IN_TPDO),
)
STORED = record.STORED_COMMUNICATION | record.STORED_APPLICATION


def restore(values, objects, flags):
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


def remaining(misfits, flags):
    """Those that are still among the saved values when entries with these flags were saved anew."""
    return [each for each in misfits if saved.outlives(each[0], each[1], flags)]


def _home(index, sub, type_, value):
    """The entry that a saved value belongs to, None if there is none that it fits."""
    try:
        entry = find(index, sub)
        if not entry.flags & STORED or entry.type != type_ or entry.size != len(value):
            return None
        entry.check_bytes(value)
    except sdo.AbortError:
        return None
    return entry


def _unsound(objects):
    """What no client could have written: sub-index of the COB-ID, and places of the objects."""
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
