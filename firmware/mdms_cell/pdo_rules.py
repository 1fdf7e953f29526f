"""What may be written to the parameters and the mapping of a PDO (CiA 301, 7.5.2.35-38)."""

from mdms_cell import pdo
from mdms_cell.objects import find
from mdms_protocol import cob, record, sdo

_BITS_MAX = 64


def check_parameter(sub, value, can_id):
    """Raises AbortError if a PDO with this identifier, None for an invalid one, may not have it."""
    if sub == pdo.COB_ID:
        from mdms_cell.cob_rules import check

        check(value, can_id, cob.FLAG_30)
    elif sub == pdo.TYPE and pdo.SYNCHRONOUS_MAX < value < pdo.EVENT_MANUFACTURER:
        raise sdo.AbortError(sdo.INVALID_VALUE)
    elif sub == pdo.INHIBIT_TIME and can_id is not None:
        raise sdo.AbortError(sdo.WRONG_STATE)


def check_mapping(entries, sub, count, direction):
    """Raises AbortError if entries, as (index, sub-index, bits), may not be mapped.

    `sub` is what was written: 0, and the entries are all that count now, or that of the one entry.
    """
    if sub and count:
        raise sdo.AbortError(sdo.WRONG_STATE)
    bits = 0
    for entry in entries:
        _check_entry(direction, *entry)
        bits += entry[2]
    if sub == 0 and bits > _BITS_MAX:
        raise sdo.AbortError(sdo.PDO_TOO_LONG)


def _check_entry(direction, index, sub, bits):
    if direction == record.IN_RPDO and index in pdo.DUMMIES and sub == 0:
        if pdo.DUMMIES[index] != bits:
            raise sdo.AbortError(sdo.NOT_MAPPABLE)
        return
    entry = find(index, sub)
    if not entry.flags & direction or entry.size * 8 != bits:
        raise sdo.AbortError(sdo.NOT_MAPPABLE)
