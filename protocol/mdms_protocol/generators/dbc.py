"""The frames of an array by default, as a CAN database (DBC) for bus monitors.

Segments of a block transfer have a sequence number in place of the command, and a frame does not
say so: a database shows them as the command that the number happens to equal.
"""

from collections import namedtuple

from mdms_protocol import pdo
from mdms_protocol.codecs import cia402, cob, lss, nmt, sdo
from mdms_protocol.neighbours import frames as n

NOBODY = "Vector__XXX"


class Database:
    """A file in the making: messages, and names of values, which come after them."""

    def __init__(self) -> None:
        self._messages: list[str] = []
        self._values: list[str] = []

    def message(self, can_id: int, name: str, length: int, sender: str = NOBODY) -> None:
        """Begin a message."""
        self._messages += ["", f"BO_ {can_id} {name}: {length} {sender}"]

    def signal(
        self,
        name: str,
        start: int,
        bits: int,
        *,
        when: str = "",
        sign: str = "+",
        scale: str = "(1,0) [0|0]",
        unit: str = "",
        receiver: str = NOBODY,
    ) -> None:
        """Add a little-endian signal to the message.

        `when` is "M" for the signal that selects others, "m1" for a signal that exists if that is
        1.
        """
        shown = f"{name} {when}".rstrip()
        self._messages.append(f' SG_ {shown} : {start}|{bits}@1{sign} {scale} "{unit}" {receiver}')

    def names(self, can_id: int, signal: str, names: dict[int, str]) -> None:
        """Name the values of a signal."""
        pairs = " ".join(f'{value} "{text}"' for value, text in sorted(names.items()))
        self._values.append(f"VAL_ {can_id} {signal} {pairs} ;")

    def text(self, nodes: list[str]) -> str:
        """The whole file, with the names of all nodes."""
        head = ['VERSION ""', "", "NS_ :", "", "BS_:", "", f"BU_: {' '.join(nodes)}"]
        return "\n".join([*head, *self._messages, "", *self._values]) + "\n"


#: A field of so many bits, signed or not, whose number times `factor` is in the unit.
Part = namedtuple("Part", ("name", "bits", "signed", "factor", "unit"), defaults=(False, 1, ""))

_STEP_M = n.STEP_UM / 1_000_000
_TURN_DEGREES = 360 / n.TURN
_ESTIMATE = (
    Part("x", 12, True, _STEP_M, "m"),
    Part("y", 12, True, _STEP_M, "m"),
    Part("yaw", 12, True, _TURN_DEGREES, "deg"),
    Part("identity", 6),
    Part("state", 2),
    Part("wants", 8),
    Part("certainty", 4),
    Part("hold", 3),
    Part("sequence", 2),
    Part("arrived", 1),
    Part("lacking", 1),
    Part("contradicted", 1),
)
_ESTIMATE_STATES = {
    n.NONE: "none",
    n.NEAR: "near",
    n.PROMISED: "promised",
    n.UNDER: "under the parcel",
}
_POSE = (
    Part("x", 18, True, _STEP_M, "m"),
    Part("y", 18, True, _STEP_M, "m"),
    Part("yaw", 12, True, _TURN_DEGREES, "deg"),
)
_PAGES: dict[int, tuple[str, tuple[Part, ...]]] = {
    n.PARCEL: (
        "parcel",
        (
            Part("shape", 2),
            Part("length", 12, False, _STEP_M, "m"),
            Part("width", 12, False, _STEP_M, "m"),
            Part("acceleration", 8, False, n.ACCELERATION_MM_S2 / 1000, "m/s2"),
            Part("speed", 8, False, n.SPEED_MM_S / 1000, "m/s"),
            Part("go_on", 1),
            Part("any_yaw", 1),
        ),
    ),
    n.PLACE: ("place", _POSE),
    n.GOAL: ("goal", (*_POSE, Part("leg", 3), Part("legs", 3))),
    n.END: ("end", ()),
}
_SHAPES = {n.RECTANGLE: "rectangle", n.DISC: "disc"}
_PAGE_START = 6
_SEQUENCE_START = 8
_BEHIND_HEAD = 10


def add_estimate(database: Database, can_id: int) -> None:
    """Add the fields of an estimate to the message just begun."""
    _add_parts(database, _ESTIMATE, 0)
    database.names(can_id, "state", _ESTIMATE_STATES)


def add_program(database: Database, can_id: int) -> None:
    """Add the pages of a motion program to the message just begun."""
    database.signal("identity", 0, 6)
    database.signal("page", _PAGE_START, 2, when="M")
    database.signal("sequence", _SEQUENCE_START, 2)
    for page, (name, parts) in _PAGES.items():
        _add_parts(database, parts, _BEHIND_HEAD, when=f"m{page}", prefix=f"{name}_")
    database.names(can_id, "page", {page: name for page, (name, _) in _PAGES.items()})
    database.names(can_id, "parcel_shape", _SHAPES)


def _add_parts(
    database: Database, parts: tuple[Part, ...], start: int, *, when: str = "", prefix: str = ""
) -> None:
    for part in parts:
        low = -(1 << part.bits - 1) if part.signed else 0
        high = low + (1 << part.bits) - 1
        database.signal(
            prefix + part.name,
            start,
            part.bits,
            when=when,
            sign="-" if part.signed else "+",
            scale=f"({part.factor!r},0) [{low * part.factor:.9g}|{high * part.factor:.9g}]",
            unit=part.unit,
        )
        start += part.bits


#: Where the command stands [bits], and its choices by value.
Choices = namedtuple("Choices", ("start", "bits", "choices"))
#: One command: its name, and its signals as (name, start, bits).
Choice = namedtuple("Choice", ("name", "signals"))

_COMMAND = "command"
_OBJECT = (("index", 8, 16), ("sub", 24, 8))
_VALUE = (("size_given", 0, 1), ("expedited", 1, 1), ("unused", 2, 2), *_OBJECT, ("value", 32, 32))
_TOGGLE = (("toggle", 4, 1),)
_SEGMENT = (("last", 0, 1), ("unused", 1, 3), *_TOGGLE, ("data", 8, 56))
_ABORT = Choice("abort", (*_OBJECT, ("code", 32, 32)))
_SEQUENCE = Choice("block segment", (("data", 8, 56),))
# Of blocks, which part of the transfer it is; what follows depends on that.
_BLOCK_1 = (("part", 0, 1), ("data", 8, 56))
_BLOCK_2 = (("part", 0, 2), ("data", 8, 56))
_SPECIFIER_START = 5
_NO_SPECIFIER = 7

_ABORT_CODES = {
    value: name.lower().replace("_", " ")
    for name, value in vars(sdo).items()
    if name.isupper() and isinstance(value, int) and value >= sdo.TOGGLE_NOT_ALTERNATED
}


def _specifiers(choices: dict[int, Choice]) -> Choices:
    found = {code >> _SPECIFIER_START: choice for code, choice in choices.items()}
    return Choices(_SPECIFIER_START, 3, found | {_NO_SPECIFIER: _SEQUENCE})


SDO_REQUEST = _specifiers(
    {
        sdo.DOWNLOAD_SEGMENT: Choice("download segment", _SEGMENT),
        sdo.DOWNLOAD: Choice("download", _VALUE),
        sdo.UPLOAD: Choice("upload", _OBJECT),
        sdo.UPLOAD_SEGMENT: Choice("upload segment", _TOGGLE),
        sdo.ABORT: _ABORT,
        sdo.BLOCK_UPLOAD: Choice("block upload", _BLOCK_2),
        sdo.BLOCK_DOWNLOAD: Choice("block download", _BLOCK_1),
    }
)
SDO_RESPONSE = _specifiers(
    {
        sdo.UPLOAD_SEGMENT_RESPONSE: Choice("upload segment", _SEGMENT),
        sdo.DOWNLOAD_SEGMENT_RESPONSE: Choice("download segment", _TOGGLE),
        sdo.UPLOAD_RESPONSE: Choice("upload", _VALUE),
        sdo.DOWNLOAD_RESPONSE: Choice("download", _OBJECT),
        sdo.ABORT: _ABORT,
        sdo.BLOCK_DOWNLOAD_RESPONSE: Choice("block download", _BLOCK_2),
        sdo.BLOCK_UPLOAD_RESPONSE: Choice("block upload", _BLOCK_1),
    }
)

_IDENTITY = ("vendor", "product", "revision", "serial")
_NUMBER = (("number", 8, 32),)
_RESULT = (("error", 8, 8), ("specific_error", 16, 8))
_RESERVED = (("reserved", 8, 56),)


def _numbered(first: int, verb: str, names: tuple[str, ...], signals: object) -> dict[int, Choice]:
    """Commands that follow each other, one a number of the identity."""
    return {code: Choice(f"{verb} {name}", signals) for code, name in enumerate(names, first)}


LSS_REQUEST = Choices(
    0,
    8,
    {
        lss.SWITCH_GLOBAL: Choice("switch global", (("mode", 8, 8),)),
        lss.CONFIGURE_NODE_ID: Choice("configure node id", (("node", 8, 8),)),
        lss.CONFIGURE_BIT_TIMING: Choice(
            "configure bit timing", (("table", 8, 8), ("entry", 16, 8))
        ),
        lss.ACTIVATE_BIT_TIMING: Choice("activate bit timing", (("delay_ms", 8, 16),)),
        lss.STORE: Choice("store", _RESERVED),
        **_numbered(lss.SWITCH_VENDOR, "switch", _IDENTITY, _NUMBER),
        **_numbered(
            lss.IDENTIFY_VENDOR,
            "identify",
            ("vendor", "product", "revision low", "revision high", "serial low", "serial high"),
            _NUMBER,
        ),
        lss.IDENTIFY_UNCONFIGURED: Choice("identify unconfigured", _RESERVED),
        lss.FAST_SCAN: Choice(
            "fast scan", (*_NUMBER, ("bit", 40, 8), ("part", 48, 8), ("next_part", 56, 8))
        ),
        **_numbered(lss.INQUIRE_VENDOR, "inquire", (*_IDENTITY, "node id"), _RESERVED),
    },
)
LSS_RESPONSE = Choices(
    0,
    8,
    {
        lss.CONFIGURE_NODE_ID: Choice("configure node id", _RESULT),
        lss.CONFIGURE_BIT_TIMING: Choice("configure bit timing", _RESULT),
        lss.STORE: Choice("store", _RESULT),
        lss.SWITCHED: Choice("switched", _RESERVED),
        lss.IDENTIFIED: Choice("identified", _RESERVED),
        lss.UNCONFIGURED: Choice("unconfigured", _RESERVED),
        **_numbered(lss.INQUIRE_VENDOR, "inquire", _IDENTITY, _NUMBER),
        lss.INQUIRE_NODE_ID: Choice("inquire node id", (("node", 8, 8),)),
    },
)


def add_choices(database: Database, can_id: int, message: Choices) -> None:
    """Add the command and all that may come with it to the message just begun."""
    database.signal(_COMMAND, message.start, message.bits, when="M")
    names = {}
    for code, choice in sorted(message.choices.items()):
        names[code] = choice.name
        prefix = choice.name.replace(" ", "_")
        for name, start, bits in choice.signals:
            database.signal(f"{prefix}_{name}", start, bits, when=f"m{code}")
    database.names(can_id, _COMMAND, names)
    if _ABORT in message.choices.values():
        database.names(can_id, "abort_code", _ABORT_CODES)


#: The array of the prototype: node ids 1 to 18.
NODES = range(1, 19)

_HOST = "Host"
_STATES = {
    nmt.INITIALISING: "boot-up",
    nmt.STOPPED: "stopped",
    nmt.OPERATIONAL: "operational",
    nmt.PRE_OPERATIONAL: "pre-operational",
}
_COMMANDS = {
    nmt.START: "start",
    nmt.STOP: "stop",
    nmt.ENTER_PRE_OPERATIONAL: "enter pre-operational",
    nmt.RESET_NODE: "reset node",
    nmt.RESET_COMMUNICATION: "reset communication",
}
_CONTROLWORDS = {
    cia402.DISABLE_VOLTAGE: "disable voltage",
    cia402.QUICK_STOP: "quick stop",
    cia402.SHUTDOWN: "shutdown",
    cia402.SWITCH_ON: "switch on",
    cia402.ENABLE_OPERATION: "enable operation",
    cia402.FAULT_RESET: "fault reset",
}


def text() -> str:
    """The whole database; the same table gives the same text."""
    database = Database()
    _network(database)
    for node in NODES:
        _node(database, node)
    return database.text([_HOST, *(f"Cell{node}" for node in NODES)])


def _network(database: Database) -> None:
    database.message(cob.NMT, "NMT", 2, _HOST)
    database.signal("command", 0, 8)
    database.signal("node", 8, 8)
    database.names(cob.NMT, "command", _COMMANDS)
    database.message(cob.SYNC, "SYNC", 0, _HOST)
    database.message(cob.LSS_REQUEST, "LSS_request", 8, _HOST)
    add_choices(database, cob.LSS_REQUEST, LSS_REQUEST)
    database.message(cob.LSS_RESPONSE, "LSS_response", 8)
    add_choices(database, cob.LSS_RESPONSE, LSS_RESPONSE)
    database.message(cob.PROGRAM, "Program", n.LENGTH, _HOST)
    add_program(database, cob.PROGRAM)
    _heartbeat(database, cob.NODE_MAX, _HOST)


def _node(database: Database, node: int) -> None:
    cell = f"Cell{node}"
    _pdo(database, node, pdo.TARGET_VELOCITY, "target_velocity", sender=_HOST)
    _pdo(database, node, pdo.CONTROLWORD, "controlword", sender=_HOST)
    for axis in (1, 2):
        can_id = pdo.CONTROLWORD.can_id(node)
        database.names(can_id, f"axis_{axis}_controlword", _CONTROLWORDS)
    _pdo(database, node, pdo.ACTUAL_VELOCITY, "actual_velocity", sender=cell)
    _pdo(database, node, pdo.STATUS, "status", sender=cell)
    estimate, program = cob.ESTIMATE_BASE + node, cob.PROGRAM_BASE + node
    database.message(estimate, f"{cell}_estimate", n.LENGTH, cell)
    add_estimate(database, estimate)
    database.message(program, f"{cell}_program", n.LENGTH, cell)
    add_program(database, program)
    database.message(cob.EMCY_BASE + node, f"{cell}_emergency", 8, cell)
    database.signal("error_code", 0, 16)
    database.signal("error_register", 16, 8)
    database.signal("source", 24, 8)
    _heartbeat(database, node, cell)
    request, response = cob.SDO_REQUEST_BASE + node, cob.SDO_RESPONSE_BASE + node
    database.message(request, f"{cell}_SDO_request", 8, _HOST)
    add_choices(database, request, SDO_REQUEST)
    database.message(response, f"{cell}_SDO_response", 8, cell)
    add_choices(database, response, SDO_RESPONSE)


def _heartbeat(database: Database, node: int, sender: str) -> None:
    can_id = cob.HEARTBEAT_BASE + node
    database.message(can_id, f"{sender}_heartbeat", 1, sender)
    database.signal("state", 0, 8)
    database.names(can_id, "state", _STATES)


def _pdo(database: Database, node: int, carried: pdo.PdoMap, name: str, sender: str) -> None:
    database.message(carried.can_id(node), f"Cell{node}_{name}", carried.length, sender)
    receiver = f"Cell{node}" if sender == _HOST else _HOST
    start = 0
    for entry in carried.entries:
        factor = entry.unit.factor
        bits = 8 * entry.type.size
        database.signal(
            entry.name.lower().replace(" ", "_"),
            start,
            bits,
            sign="-" if entry.type.low < 0 else "+",
            scale=f"({factor!r},0) [{entry.low * factor:.9g}|{entry.high * factor:.9g}]",
            unit=entry.unit.symbol,
            receiver=receiver,
        )
        start += bits
