"""The object table of a cell, the only source of data on the wire.

The host encodes with it; the cell's packed dictionary, `mdms-cell.eds`, `mdms-cell.dbc` and
`OBJECTS.md` are generated from it by `make generate`.

Everything is an integer: speeds in micrometres per second, voltages in microvolts or millivolts,
times in milliseconds. The unit of a field turns the integer into SI.
"""

from mdms_protocol import entry as e
from mdms_protocol.codecs import cob
from mdms_protocol.entry import (
    CONST,
    DOMAIN,
    I8,
    I16,
    I32,
    READ,
    U8,
    U16,
    U32,
    WRITE,
    Field,
    array,
    field,
    record,
    setting,
)
from mdms_protocol.version import VERSION

UPDATE_OBJECTS: dict[int, Field | e.Group] = {
    0x1F50: array("Program data", 1, field("Program", DOMAIN, WRITE)),
    0x1F51: array("Program control", 1, field("Control of program", U8, default=1)),
    0x1F56: array("Program software identification", 1, field("Identification", U32, READ)),
    0x1F57: array("Flash status identification", 1, field("Flash status", U32, READ)),
    0x3030: record(
        "Update",
        {
            1: field("Update key", DOMAIN, WRITE),
            2: field("Update key identification", U32, READ),
            3: field("Update board", U8, READ),
            4: field("Update bytecode", U16, READ),
            5: field("Update room", U32, READ),
            6: field("Update counter", U32, READ),
            7: field("Update slot", U8, READ),
            8: field("Update on trial", U8, READ),
        },
    ),
}


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
            2: setting("Beat period", U16, 10, e.MILLISECONDS, low=8, high=50),
            3: setting("SYNC takeover", U8, high=1),
            4: setting("SYNC takeover rank", U8, high=cob.CELL_NODE_MAX),
        },
    ),
    0x3015: field("Suspect", U8, READ),
    ESTIMATE: _halves("Estimate", READ, e.TPDO),
    PROGRAM: _halves("Program", e.READ_WRITE, e.BOTH),
}


VENDOR_ID = 0
PRODUCT_CODE = 0x4D444D53
REVISION = 0x00010000
DEVICE_NAME = "MDMS cell"
HARDWARE_VERSION = "2 wheels, 5 sensors"

AXES = 2
#: From an object of axis 1 to that of axis 2 (CiA 402-1).
AXIS_OFFSET = 0x800
PDOS = len(cob.TPDO_BASES)
PDO_ENTRIES = 8
ERROR_HISTORY = 8
CONSUMED_HEARTBEATS = 4

SPEED_LIMIT_UM_S = 10_000_000
ACCELERATION_LIMIT_UM_S2 = 1_000_000_000

# Transmission types of PDOs (CiA 301, 7.5.2.35 and 7.5.2.37); the manufacturer's own, 254, leaves
# it to the neighbour layer when a transmit PDO is sent.
SYNCHRONOUS = 1
SYNCHRONOUS_MAX = 240
BY_THE_LAYER = 254
EVENT_DRIVEN = 255


def mapped(index: int, sub: int, bits: int) -> int:
    """The value of a PDO mapping entry."""
    return index << 16 | sub << 8 | bits


# What the PDOs carry until they are remapped: mapping entries of PDO 1 to 4.
RPDO_MAPS: tuple[tuple[int, ...], ...] = (
    (mapped(0x60FF, 0, 32), mapped(0x68FF, 0, 32)),
    (mapped(0x6040, 0, 16), mapped(0x6840, 0, 16)),
    (mapped(PROGRAM, 1, 32), mapped(PROGRAM, 2, 32)),
    (),
)
TPDO_MAPS: tuple[tuple[int, ...], ...] = (
    (mapped(0x606C, 0, 32), mapped(0x686C, 0, 32)),
    (mapped(0x6041, 0, 16), mapped(0x6841, 0, 16), mapped(0x3001, 0, 8)),
    (mapped(ESTIMATE, 1, 32), mapped(ESTIMATE, 2, 32)),
    (mapped(PROGRAM, 1, 32), mapped(PROGRAM, 2, 32)),
)
_RPDO_TYPES = (SYNCHRONOUS, EVENT_DRIVEN, EVENT_DRIVEN, EVENT_DRIVEN)
_TPDO_TYPES = (SYNCHRONOUS, EVENT_DRIVEN, BY_THE_LAYER, BY_THE_LAYER)


def _communication(
    name: str,
    type_: e.Type,
    default: int = 0,
    unit: e.Unit = e.PLAIN,
    *,
    low: int | None = None,
    high: int | None = None,
) -> Field:
    return field(
        name, type_, default=default, unit=unit, low=low, high=high, stored=e.COMMUNICATION
    )


def _groups(verb: str) -> dict[int, Field]:
    names = ("all parameters", "communication parameters", "application parameters")
    return {sub: field(verb + name, U32, default=1) for sub, name in enumerate(names, 1)}


def _cob_id(name: str, base: int, access: str = e.READ_WRITE) -> Field:
    stored = e.COMMUNICATION if access == e.READ_WRITE else None
    return field(name, U32, access, base, stored=stored, from_node=True)


_COMMUNICATION: dict[int, Field | e.Group] = {
    0x1000: field("Device type", U32, CONST, 0xFFFF0192),
    0x1001: field("Error register", U8, READ, mappable=e.TPDO),
    0x1003: array(
        "Pre-defined error field",
        ERROR_HISTORY,
        field("Standard error field", U32, READ),
        field("Number of errors", U8),
    ),
    0x1005: _communication("COB-ID SYNC", U32, cob.SYNC),
    0x1006: field("Communication cycle period", U32, READ, unit=e.MICROSECONDS),
    0x1008: field("Manufacturer device name", e.TEXT, CONST, DEVICE_NAME),
    0x1009: field("Manufacturer hardware version", e.TEXT, CONST, HARDWARE_VERSION),
    0x100A: field("Manufacturer software version", e.TEXT, CONST, VERSION),
    0x1010: record("Store parameters", _groups("Save ")),
    0x1011: record("Restore default parameters", _groups("Restore ")),
    0x1014: _cob_id("COB-ID EMCY", cob.EMCY_BASE),
    0x1015: _communication("Inhibit time EMCY", U16, 0, e.TENTHS_OF_MILLISECONDS),
    0x1016: array(
        "Consumer heartbeat time",
        CONSUMED_HEARTBEATS,
        _communication("Consumer heartbeat time", U32, high=0x7FFFFF),
    ),
    0x1017: _communication("Producer heartbeat time", U16, 100, e.MILLISECONDS),
    0x1018: record(
        "Identity object",
        {
            1: field("Vendor-ID", U32, CONST, VENDOR_ID),
            2: field("Product code", U32, CONST, PRODUCT_CODE),
            3: field("Revision number", U32, CONST, REVISION),
            4: field("Serial number", U32, READ),
        },
    ),
    0x1029: record("Error behaviour", {1: _communication("Communication error", U8, high=2)}),
    0x1200: record(
        "SDO server parameter",
        {
            1: _cob_id("COB-ID client to server", cob.SDO_REQUEST_BASE, READ),
            2: _cob_id("COB-ID server to client", cob.SDO_RESPONSE_BASE, READ),
        },
    ),
}

_CELL: dict[int, Field | e.Group] = {
    0x3000: setting("Setpoint timeout", U16, 50, e.MILLISECONDS, low=1, high=500),
    0x3001: field("Presence", U8, READ, mappable=e.TPDO),
    0x3002: record(
        "Traffic",
        {
            1: field("Frames received", U32, READ),
            2: field("Frames dropped", U32, READ),
            3: field("Frames not sent", U32, READ),
            4: field("Frames overrun", U32, READ),
            5: field("Transmit error counter", U32, READ),
            6: field("Receive error counter", U32, READ),
        },
    ),
    0x3003: setting("Undervoltage limit", U16, 10_000, e.MILLIVOLTS, high=60_000),
    0x3004: setting("Braking time limit", U16, 2_000, e.MILLISECONDS, low=100, high=10_000),
    0x3005: field("Configuration signature", U32, READ),
    0x3006: setting("Presence debounce", U16, 4, e.MILLISECONDS, high=100),
    0x3007: field("Identify", U16, unit=e.MILLISECONDS),
    0x3008: record(
        "Memory",
        {
            1: field("Heap free", U32, READ),
            2: field("Flash free", U32, READ),
        },
    ),
}

_SPEED = e.MICROMETRES_PER_SECOND
_ACCELERATION = e.MICROMETRES_PER_SECOND2
_AXIS: dict[int, Field] = {
    0x2000: setting("gain", U32, 13_000, e.MILLIVOLT_SECONDS_PER_METRE, high=100_000),
    0x2001: setting("resolution", U32, 37_595, e.PER_METRE, low=1_000, high=1_000_000),
    0x2002: setting("voltage limit", U32, 24_000, e.MILLIVOLTS, high=60_000),
    0x2003: field("motor voltage", I32, READ, unit=e.MICROVOLTS, mappable=e.TPDO),
    0x2004: setting("stall voltage", U32, 6_000, e.MILLIVOLTS, high=60_000),
    0x2005: setting("stall time", U16, 80, e.MILLISECONDS),
    0x2006: setting("over-current time", U16, 100, e.MILLISECONDS),
    0x2007: setting("slippage time", U16, 500, e.MILLISECONDS),
    0x2008: setting("observer lag", U16, 1_900, e.MICROSECONDS, low=1_000, high=20_000),
    0x2009: setting("direction", I32, 0, e.MICRORADIANS, low=-3_141_593, high=3_141_593),
    0x200A: setting("acceleration per volt", U16, 20_053, e.MILLIMETRES_PER_SECOND2_PER_VOLT),
    0x200B: setting("reversal voltage", U32, 2_000, e.MILLIVOLTS, high=60_000),
    0x200C: setting("reversal time", U16, 80, e.MILLISECONDS),
    0x200D: setting("contact x", I32, -30_000, e.MICROMETRES, low=-REACH_UM, high=REACH_UM),
    0x200E: setting("contact y", I32, 0, e.MICROMETRES, low=-REACH_UM, high=REACH_UM),
    0x200F: setting("braking gain", U32, 65_000, e.MILLIVOLT_SECONDS_PER_METRE, high=100_000),
    0x2010: field("trial voltage limit", U32, unit=e.MILLIVOLTS, high=60_000),
    0x603F: field("error code", U16, READ, mappable=e.TPDO),
    0x6040: field("controlword", U16, mappable=e.RPDO),
    0x6041: field("statusword", U16, READ, mappable=e.TPDO),
    0x605A: field("quick stop option code", I16, CONST, 2),
    0x605E: setting("fault reaction option code", I16, 2, low=0, high=2),
    0x6060: field("modes of operation", I8, default=3, low=3, high=3, mappable=e.RPDO),
    0x6061: field("modes of operation display", I8, READ, 3, mappable=e.TPDO),
    0x6063: field("position", I32, READ, unit=e.COUNTS, mappable=e.TPDO),
    0x606B: field("velocity demand value", I32, READ, unit=_SPEED, mappable=e.TPDO),
    0x606C: field("velocity actual value", I32, READ, unit=_SPEED, mappable=e.TPDO),
    0x606D: setting("velocity window", U16, 10_000, _SPEED),
    0x606E: setting("velocity window time", U16, 10, e.MILLISECONDS),
    0x6073: setting("max current", U16, 1_500, e.PER_MILLE, high=10_000),
    0x6075: setting("motor rated current", U32, 2_000, e.MILLIAMPERES, low=1, high=100_000),
    0x6078: field("current actual value", I16, READ, unit=e.PER_MILLE, mappable=e.TPDO),
    0x6079: field("DC link circuit voltage", U32, READ, unit=e.MILLIVOLTS, mappable=e.TPDO),
    0x607E: setting("polarity", U8, high=0x40),
    0x6083: setting("profile acceleration", U32, 0, _ACCELERATION, high=ACCELERATION_LIMIT_UM_S2),
    0x6084: setting("profile deceleration", U32, 0, _ACCELERATION, high=ACCELERATION_LIMIT_UM_S2),
    0x6085: setting(
        "quick stop deceleration",
        U32,
        8_000_000,
        _ACCELERATION,
        low=1_000,
        high=ACCELERATION_LIMIT_UM_S2,
    ),
    0x60F8: setting("max slippage", I32, 0, _SPEED, low=0, high=SPEED_LIMIT_UM_S),
    0x60FF: field(
        "target velocity",
        I32,
        unit=_SPEED,
        low=-SPEED_LIMIT_UM_S,
        high=SPEED_LIMIT_UM_S,
        mappable=e.RPDO,
    ),
    0x6502: field("supported drive modes", U32, CONST, 1 << 2),
    0x67FF: field("single device type", U32, CONST, 0x00020192),
}
#: Where the wheels of the prototype differ: axis 2 pushes along y.
_AXIS_2_DEFAULTS = {0x2009: 1_570_796, 0x200D: 30_000}


def _axis(number: int) -> dict[int, Field]:
    objects: dict[int, Field] = {}
    for index, item in _AXIS.items():
        default = _AXIS_2_DEFAULTS.get(index, item.default) if number else item.default
        name = "Axis %d %s" % (number + 1, item.name)
        objects[index + number * AXIS_OFFSET] = Field(name, *item[1:6], default, *item[7:])
    return objects


def _mapping(name: str, entries: tuple[int, ...]) -> e.Group:
    fields = {}
    for sub in range(1, PDO_ENTRIES + 1):
        default = entries[sub - 1] if sub <= len(entries) else 0
        fields[sub] = _communication("Mapping entry %d" % sub, U32, default)
    count = _communication("Number of mapped objects", U8, len(entries), high=PDO_ENTRIES)
    return record(name + "mapping", fields, count)


def _parameters(name: str, cob_id: Field, type_: int, more: dict[int, Field]) -> e.Group:
    fields = {
        1: cob_id,
        2: _communication("Transmission type", U8, type_),
        5: _communication("Event timer", U16, 0, e.MILLISECONDS),
    }
    fields.update(more)
    return record(name + "communication", fields)


def _pdos(number: int) -> dict[int, e.Group]:
    rpdo = "RPDO %d " % (number + 1)
    tpdo = "TPDO %d " % (number + 1)
    sent = _cob_id("COB-ID", cob.FLAG_30 | cob.TPDO_BASES[number])
    inhibit = {3: _communication("Inhibit time", U16, 0, e.TENTHS_OF_MILLISECONDS)}
    return {
        0x1400 + number: _parameters(rpdo, _received(number), _RPDO_TYPES[number], {}),
        0x1600 + number: _mapping(rpdo, RPDO_MAPS[number]),
        0x1800 + number: _parameters(tpdo, sent, _TPDO_TYPES[number], inhibit),
        0x1A00 + number: _mapping(tpdo, TPDO_MAPS[number]),
    }


def _received(number: int) -> Field:
    """The COB-ID of a receive PDO; that of motion programs is the same on all cells."""
    base = cob.RPDO_BASES[number]
    if base + cob.HOST_NODE == cob.PROGRAM:
        return _communication("COB-ID", U32, cob.PROGRAM)
    return _cob_id("COB-ID", base if RPDO_MAPS[number] else base | cob.INVALID)


def _objects() -> tuple[e.Object, ...]:
    objects: dict[int, Field | e.Group] = {}
    objects.update(_COMMUNICATION)
    objects.update(_CELL)
    objects.update(NEIGHBOUR_OBJECTS)
    objects.update(UPDATE_OBJECTS)
    for number in range(PDOS):
        objects.update(_pdos(number))
    for number in range(AXES):
        objects.update(_axis(number))
    return tuple(e.placed(index, objects[index]) for index in sorted(objects))


#: All objects in the order of their indices.
OBJECTS = _objects()
#: Their entries by (index, sub-index).
ENTRIES: dict[tuple[int, int], e.Entry] = {
    (entry.index, entry.sub): entry for each in OBJECTS for entry in each.entries
}
