"""The object table as a page to read."""

from mdms_protocol import entry as e
from mdms_protocol.dictionary import OBJECTS, RPDO_MAPS, TPDO_MAPS

_HEAD = """\
# Objects of a cell

Written by `make generate` from `mdms_protocol/dictionary.py`; change that.

Everything on the wire is a little-endian integer; value times factor is in the unit. 'Stored' says
with which group of 0x1010 an entry is saved. A default with 'node +' is counted from the node id.
Objects of axis 2 lie 0x800 above those of axis 1.

"""
_COLUMNS = (
    "Index",
    "Sub",
    "Name",
    "Type",
    "Access",
    "Default",
    "Limits",
    "Unit",
    "Factor",
    "PDO",
    "Stored",
)
_DIRECTIONS = {0: "", e.RPDO: "receive", e.TPDO: "transmit", e.BOTH: "both"}


def text() -> str:
    """The whole page; the same table gives the same text."""
    rows = [_row(entry) for each in OBJECTS for entry in each.entries]
    table = [_line(_COLUMNS), _line(("---",) * len(_COLUMNS)), *map(_line, rows)]
    return _HEAD + "\n".join([*_maps(), "## Table", "", *table]) + "\n"


def _maps() -> list[str]:
    lines = ["## Default process data", "", _line(("PDO", "Carries")), _line(("---", "---"))]
    for name, maps in (("RPDO", RPDO_MAPS), ("TPDO", TPDO_MAPS)):
        for number, items in enumerate(maps, 1):
            carried = ", ".join(f"0x{item >> 16:04X}:{item >> 8 & 0xFF}" for item in items)
            lines.append(_line((f"{name} {number}", carried or "nothing, not in use")))
    return [*lines, ""]


def _row(entry: e.Entry) -> tuple[str, ...]:
    return (
        f"0x{entry.index:04X}",
        str(entry.sub),
        entry.name,
        entry.type.name,
        entry.access,
        _default(entry),
        _limits(entry),
        entry.unit.symbol,
        "" if entry.unit.factor == 1 else f"{entry.unit.factor:g}",
        _DIRECTIONS[entry.mappable],
        entry.stored or "",
    )


def _default(entry: e.Entry) -> str:
    if entry.type == e.DOMAIN:
        return ""
    if entry.from_node:
        return f"node + 0x{entry.default:X}"
    if entry.type == e.U32 and entry.default > 0xFFFF and not entry.unit.symbol:
        return f"0x{entry.default:08X}"
    return str(entry.default)


def _limits(entry: e.Entry) -> str:
    if (entry.low, entry.high) == (entry.type.low, entry.type.high):
        return ""
    return f"{entry.low} to {entry.high}"


def _line(cells: tuple[str, ...]) -> str:
    return "| " + " | ".join(cells) + " |"
