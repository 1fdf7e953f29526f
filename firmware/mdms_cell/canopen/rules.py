"""Rules for COB-IDs, PDO parameters and mappings (CiA 301, table 41, 7.5.2.35-38)."""

from mdms_cell.canopen.objects import find
from mdms_protocol import record
from mdms_protocol.codecs import cob, sdo

# Sub-indices of the parameters of a PDO
COB_ID = 1
TYPE = 2
INHIBIT_TIME = 3
EVENT_TIMER = 5

#: Transmission types: 0 to 240 go with SYNC, the last two with events.
SYNCHRONOUS_MAX = 240
EVENT_MANUFACTURER = 254
EVENT_PROFILE = 255

#: Bits of the data types that a receive PDO may carry for others: CiA 301, 7.4.7.3, dummy mapping.
DUMMIES = {2: 8, 3: 16, 4: 32, 5: 8, 6: 16, 7: 32}

_BITS_MAX = 64


def check_cob_id(cob_id, can_id_before, ignored=0):
    """Raises AbortError if a service with this identifier, or None, may not have it.

    The bits `ignored` may be set. There are no identifiers of 29 bits, not even switched off.
    """
    if cob_id & cob.EXTENDED:
        raise sdo.AbortError(sdo.INVALID_VALUE)
    if cob_id & cob.INVALID:
        return
    can_id = cob_id & cob.IDENTIFIER
    check_plain(cob_id & ~ignored)
    if can_id_before is not None and can_id_before != can_id:
        raise sdo.AbortError(sdo.WRONG_STATE)


def check_plain(cob_id):
    """Raises AbortError if it is no identifier alone that a service may be given."""
    if cob_id != cob_id & cob.IDENTIFIER or cob.restricted(cob_id):
        raise sdo.AbortError(sdo.INVALID_VALUE)


def check_parameter(direction, sub, value, can_id):
    """Raises AbortError if a PDO with this identifier, None for an invalid one, may not have it.

    Bit 30 of a valid TPDO is set, for it answers no remote request; in an RPDO it means nothing.
    """
    if sub == COB_ID:
        check_cob_id(value, can_id, cob.FLAG_30)
        if direction == record.IN_TPDO and not value & (cob.INVALID | cob.FLAG_30):
            raise sdo.AbortError(sdo.INVALID_VALUE)
    elif sub == TYPE and SYNCHRONOUS_MAX < value < EVENT_MANUFACTURER:
        raise sdo.AbortError(sdo.INVALID_VALUE)
    elif sub == INHIBIT_TIME and can_id is not None:
        raise sdo.AbortError(sdo.WRONG_STATE)


def check_pdo(objects, parameters, mapping, direction):
    """Raises AbortError if parameters or mapping of a PDO are not allowed."""
    for sub in (COB_ID, TYPE):
        check_parameter(direction, sub, objects.number(parameters, sub), None)
    count = objects.number(mapping)
    entries = [mapped(objects, mapping, sub) for sub in range(1, count + 1)]
    check_mapping(entries, 0, count, direction)


def mapped(objects, mapping, sub):
    """An entry of a mapping as (index, sub-index, bits)."""
    item = objects.number(mapping, sub)
    return item >> 16, item >> 8 & 0xFF, item & 0xFF


#: An entry that maps nothing, as all are that are not in use.
_EMPTY = (0, 0, 0)


def check_mapping(entries, sub, count, direction):
    """Raises AbortError if entries, as (index, sub-index, bits), may not be mapped.

    `sub` is the sub-index that was written. If it is 0, the entries are all that are mapped. Else
    there is one entry, and it is that of `sub`.
    """
    if sub and count:
        raise sdo.AbortError(sdo.WRONG_STATE)
    if sub and entries == [_EMPTY]:
        return
    bits = 0
    for entry in entries:
        _check_entry(direction, *entry)
        bits += entry[2]
    if sub == 0 and bits > _BITS_MAX:
        raise sdo.AbortError(sdo.PDO_TOO_LONG)


def _check_entry(direction, index, sub, bits):
    if direction == record.IN_RPDO and index in DUMMIES and sub == 0:
        if DUMMIES[index] != bits:
            raise sdo.AbortError(sdo.NOT_MAPPABLE)
        return
    entry = find(index, sub)
    if not entry.flags & direction or entry.size * 8 != bits:
        raise sdo.AbortError(sdo.NOT_MAPPABLE)
