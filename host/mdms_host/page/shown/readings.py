"""An object's value as a person reads it: with its unit, or as what its bits say."""

from collections.abc import Callable

from mdms_host.can_link.emergencies import code_text
from mdms_protocol import indices
from mdms_protocol.codecs import cia402, cob
from mdms_protocol.dictionary import ENTRIES, OBJECTS
from mdms_protocol.entry import Entry

GROUPS = {item.index: item.name for item in OBJECTS}
#: Bit 31 of a COB-ID: the PDO or emergency is off (CiA 301).
_OFF = 1 << 31
#: Bit 30 of 0x1005: this node sends SYNC.
_PRODUCER = 1 << 30
_SHARE = "1"


def name_of(entry: Entry) -> str:
    """What an entry is called, with its object where that says more."""
    group = GROUPS[entry.index]
    return entry.name if group in entry.name else f"{group}: {entry.name}"


def reading_of(entry: Entry, value: int) -> str:
    """The value as text."""
    for words, reading in _READINGS:
        if any(word in entry.name for word in words):
            return reading(entry, value)
    return _number(entry, value)


def _hex(entry: Entry, value: int) -> str:
    return f"0x{value:0{2 * entry.type.size}X}"


def _cob_id(entry: Entry, value: int) -> str:
    notes = ", off" if value & _OFF else ""
    if entry.index == indices.SYNC_COB_ID and value & _PRODUCER:
        notes = ", sent by this cell"
    return f"0x{value & cob.IDENTIFIER:03X}{notes}"


def _mapping(_entry: Entry, value: int) -> str:
    """Index, sub-index and length in bits of the object that is mapped, and its name."""
    if not value:
        return "none"
    entry = ENTRIES.get((value >> 16, value >> 8 & 0xFF))
    return f"0x{value:08X}, {name_of(entry) if entry else 'nothing that there is'}"


def _heartbeat(_entry: Entry, value: int) -> str:
    return f"node {value >> 16 & 0x7F} within {value & 0xFFFF} ms" if value else "none"


def _statusword(entry: Entry, value: int) -> str:
    state = cia402.state(value)
    return f"{_hex(entry, value)}, {cia402.NAMES[state] if state is not None else 'no state'}"


def _error(_entry: Entry, value: int) -> str:
    return code_text(value & 0xFFFF) if value else "none"


def _bits(_entry: Entry, value: int) -> str:
    return f"0b{value:05b}"


def _number(entry: Entry, value: int) -> str:
    unit = entry.unit
    if unit.symbol == _SHARE:
        return f"{100 * value * unit.factor:.6g} %"
    return f"{value * unit.factor:.6g} {unit.symbol}" if unit.symbol else f"{value}"


#: By a word of the entry's name, the first that fits; all others are numbers with their units.
_READINGS: tuple[tuple[tuple[str, ...], Callable[[Entry, int], str]], ...] = (
    (("COB-ID",), _cob_id),
    (("Mapping entry",), _mapping),
    (("Consumer heartbeat",), _heartbeat),
    (("statusword",), _statusword),
    (("error code", "error field"), _error),
    (("Presence sensor", "Presence debounce"), _number),
    (("Presence",), _bits),
    (
        (
            *("evice type", "Error register", "Vendor-ID", "Product code", "Serial number"),
            *("controlword", "drive modes", "signature", "Bytes"),
        ),
        _hex,
    ),
)
