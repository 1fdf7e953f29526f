"""A row of the object table, and short ways to write groups of rows."""

from collections import namedtuple


class OutOfRangeError(ValueError):
    """A value does not fit its object; the message names object, value and limits."""


#: `code` is the data type's index in CiA 301 (table 44), `size` its bytes, 0 if the value has its
#: own length; `low` and `high` bound the numbers that it holds.
Type = namedtuple("Type", ("name", "code", "size", "low", "high"))

I8 = Type("INTEGER8", 0x02, 1, -(1 << 7), (1 << 7) - 1)
I16 = Type("INTEGER16", 0x03, 2, -(1 << 15), (1 << 15) - 1)
I32 = Type("INTEGER32", 0x04, 4, -(1 << 31), (1 << 31) - 1)
U8 = Type("UNSIGNED8", 0x05, 1, 0, (1 << 8) - 1)
U16 = Type("UNSIGNED16", 0x06, 2, 0, (1 << 16) - 1)
U32 = Type("UNSIGNED32", 0x07, 4, 0, (1 << 32) - 1)
TEXT = Type("VISIBLE_STRING", 0x09, 0, 0, 0)
#: Any bytes, as many as are sent; a cell holds none of them in its table.
DOMAIN = Type("DOMAIN", 0x0F, 0, 0, 0)

#: `factor` turns an object's integer into the SI unit `symbol`.
Unit = namedtuple("Unit", ("symbol", "factor"))

PLAIN = Unit("", 1)
COUNTS = Unit("counts", 1)
PER_METRE = Unit("counts/m", 1)
MICROMETRES = Unit("m", 1e-6)
MICROMETRES_PER_SECOND = Unit("m/s", 1e-6)
MICROMETRES_PER_SECOND2 = Unit("m/s2", 1e-6)
MILLIMETRES_PER_SECOND2_PER_VOLT = Unit("m/s2/V", 1e-3)
MICROVOLTS = Unit("V", 1e-6)
MILLIVOLTS = Unit("V", 1e-3)
MILLIVOLT_SECONDS_PER_METRE = Unit("V s/m", 1e-3)
MILLIAMPERES = Unit("A", 1e-3)
PER_MILLE = Unit("1", 1e-3)
MICRORADIANS = Unit("rad", 1e-6)
MILLISECONDS = Unit("s", 1e-3)
MICROSECONDS = Unit("s", 1e-6)
TENTHS_OF_MILLISECONDS = Unit("s", 1e-4)


def steps_per_unit(unit: Unit) -> int:
    """How many steps of the integer make one of the unit."""
    steps: int = round(1 / unit.factor)
    return steps


# Access
CONST = "const"
READ = "ro"
WRITE = "wo"
READ_WRITE = "rw"

# Directions in which a PDO may carry the object, seen from the cell
RPDO = 1
TPDO = 2
BOTH = RPDO | TPDO

# Groups of 0x1010 and 0x1011 that an object is stored with
COMMUNICATION = "communication"
APPLICATION = "application"

#: What an entry says besides its place: `low` and `high` bound what may be written, `stored` is a
#: group or None; with `from_node` the default is counted from the node id.
Field = namedtuple(
    "Field",
    (
        "name",
        "type",
        "unit",
        "low",
        "high",
        "access",
        "default",
        "mappable",
        "stored",
        "from_node",
    ),
)
#: A field at its place in the table.
Entry = namedtuple(
    "Entry",
    (
        "index",
        "sub",
        "name",
        "type",
        "unit",
        "low",
        "high",
        "access",
        "default",
        "mappable",
        "stored",
        "from_node",
    ),
)

VARIABLE = 7
ARRAY = 8
RECORD = 9

#: Several fields by sub-index under one name and index.
Group = namedtuple("Group", ("name", "kind", "fields"))
#: One index: its name, what kind of object it is, and its entries in the order of sub-indices.
Object = namedtuple("Object", ("index", "name", "kind", "entries"))


def field(
    name: str,
    type_: Type,
    access: str = READ_WRITE,
    default: int | str = 0,
    *,
    unit: Unit = PLAIN,
    low: int | None = None,
    high: int | None = None,
    mappable: int = 0,
    stored: str | None = None,
    from_node: bool = False,
) -> Field:
    """A field with the limits of its type, unless told others."""
    low = type_.low if low is None else low
    high = type_.high if high is None else high
    return Field(name, type_, unit, low, high, access, default, mappable, stored, from_node)


def setting(
    name: str,
    type_: Type,
    default: int = 0,
    unit: Unit = PLAIN,
    *,
    low: int | None = None,
    high: int | None = None,
) -> Field:
    """A field that is stored with the application's parameters."""
    return field(name, type_, default=default, unit=unit, low=low, high=high, stored=APPLICATION)


def record(name: str, fields: dict[int, Field], count: Field | None = None) -> Group:
    """A group of unlike fields; `count` replaces the constant sub-index 0."""
    rows = {0: count or field("Highest sub-index supported", U8, CONST, max(fields))}
    rows.update(fields)
    return Group(name, RECORD, rows)


def array(name: str, size: int, each: Field, count: Field | None = None) -> Group:
    """A group of `size` fields alike; `count` as `record`."""
    rows = {0: count or field("Highest sub-index supported", U8, CONST, size)}
    for sub in range(1, size + 1):
        rows[sub] = Field("%s %d" % (each.name, sub), *each[1:])
    return Group(name, ARRAY, rows)


def placed(index: int, item: Field | Group) -> Object:
    """The object that a field or group makes at an index."""
    if isinstance(item, Field):
        return Object(index, item.name, VARIABLE, (Entry(index, 0, *item),))
    entries = tuple(Entry(index, sub, *item.fields[sub]) for sub in sorted(item.fields))
    return Object(index, item.name, item.kind, entries)
