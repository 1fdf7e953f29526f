"""SDO and LSS in a CAN database: a command, and the signals that are there with it.

Segments of a block transfer have a sequence number in place of the command, and a frame does not
say so: a database shows them as the command that the number happens to equal.
"""

from collections import namedtuple

from mdms_protocol.codecs import lss, sdo
from mdms_protocol.generators.dbc_lines import Database

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
