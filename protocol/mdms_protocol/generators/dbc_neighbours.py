"""Estimates and motion programs in a CAN database: fields within the eight bytes of a frame."""

from collections import namedtuple

from mdms_protocol.generators.dbc_lines import Database
from mdms_protocol.neighbours import frames as n

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
_STATES = {
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
            Part("unplanned", 1),
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
    database.names(can_id, "state", _STATES)


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
