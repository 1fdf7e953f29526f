"""The objects of the neighbour layer: a cell's place, its neighbours, and their messages."""

from mdms_protocol import entry as e
from mdms_protocol.codecs import cob
from mdms_protocol.entry import I32, READ, U8, U16, U32, Field, field, record, setting

#: Index of what a cell believes of its parcel, and of the motion program that is handed on.
ESTIMATE = 0x3021
PROGRAM = 0x3022

#: Farthest that a contact or a sensor lies from the cell's centre, and a cell from the table's.
REACH_UM = 1_000_000
_TABLE_UM = 100_000_000

_SENSOR_OFFSETS_UM = (
    (0, 0),
    (31_750, 31_750),
    (-31_750, 31_750),
    (-31_750, -31_750),
    (31_750, -31_750),
)


#: In the order of directions, counterclockwise from +x; that of direction d has sub-index d + 1.
DIRECTIONS = (
    "east",
    "north-east",
    "north",
    "north-west",
    "west",
    "south-west",
    "south",
    "south-east",
)


def _within(name: str, default: int, limit_um: int) -> Field:
    return setting(name, I32, default, e.MICROMETRES, low=-limit_um, high=limit_um)


def _array(name: str, fields: dict[int, Field]) -> e.Group:
    """An array whose fields differ in name and default."""
    return e.Group(name, e.ARRAY, record(name, fields).fields)


def _neighbours() -> e.Group:
    fields = {
        number: setting("Neighbour " + direction, U8, high=cob.CELL_NODE_MAX)
        for number, direction in enumerate(DIRECTIONS, 1)
    }
    return _array("Neighbour", fields)


def _sensor_offsets() -> e.Group:
    fields = {}
    for number, offset_um in enumerate(_SENSOR_OFFSETS_UM):
        for axis, default in enumerate(offset_um):
            name = "Presence sensor %d %s" % (number + 1, "xy"[axis])
            fields[2 * number + axis + 1] = _within(name, default, REACH_UM)
    return _array("Presence sensor offset", fields)


def _halves(name: str, access: str, mappable: int) -> e.Group:
    """The eight bytes of a frame as two numbers."""
    fields = {
        1: field("Bytes 1 to 4", U32, access, mappable=mappable),
        2: field("Bytes 5 to 8", U32, access, mappable=mappable),
    }
    return record(name, fields)


#: By index; what a frame of `ESTIMATE` or `PROGRAM` says is in `mdms_protocol.neighbours.frames`.
NEIGHBOUR_OBJECTS: dict[int, Field | e.Group] = {
    0x3010: record(
        "Place",
        {
            1: setting("Place column", U8),
            2: setting("Place row", U8),
            3: _within("Place x", 0, _TABLE_UM),
            4: _within("Place y", 0, _TABLE_UM),
            5: setting("Place pitch", U32, 127_000, e.MICROMETRES, low=1_000, high=REACH_UM),
        },
    ),
    0x3011: _neighbours(),
    0x3012: _sensor_offsets(),
    0x3013: setting("Control", U8, high=1),
    0x3014: record(
        "Lease",
        {
            1: setting("Lease beats", U8, 10, low=3, high=100),
            2: setting("Beat period", U16, 10, e.MILLISECONDS, low=5, high=100),
            3: setting("SYNC takeover", U8, high=1),
            4: setting("SYNC takeover rank", U8, high=cob.CELL_NODE_MAX),
        },
    ),
    0x3015: field("Suspect", U8, READ),
    ESTIMATE: _halves("Estimate", READ, e.TPDO),
    PROGRAM: _halves("Program", e.READ_WRITE, e.BOTH),
}
