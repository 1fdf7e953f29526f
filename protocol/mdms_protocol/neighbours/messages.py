"""Estimates and pages of motion programs as values, for the host: checked before they are sent."""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from array import array
from collections import namedtuple

from mdms_protocol.entry import OutOfRangeError
from mdms_protocol.neighbours import frames as n
from mdms_protocol.neighbours import lost
from mdms_protocol.neighbours import precedence as p

#: What a cell believes and promises; fields as in `neighbours`.
Estimate = namedtuple(
    "Estimate",
    "x y yaw identity state wants certainty hold sequence flags",
)
#: Pages of a program; `page` is what distinguishes them on the wire.
Parcel = namedtuple(
    "Parcel",
    "identity sequence shape length width acceleration speed flags",
)
Place = namedtuple("Place", "identity sequence x y yaw")
#: `leg` and `legs` as in `frames`; where both are 0 nothing follows the goal.
Goal = namedtuple("Goal", "identity sequence x y yaw leg legs")
End = namedtuple("End", "identity sequence")
#: The identities in which parcels come over the cell at a column and row, both from 1; at most
#: `precedence.PLACES` of them. `number` as in `precedence`.
Precedence = namedtuple("Precedence", "number column row identities")

#: The cell at a column and row is lost, and which parcel may cross its square; a host's page, or a
#: neighbour's answer. `kind` and `number` as in `lost`.
Lost = namedtuple("Lost", "kind column row identity number")

#: Any page of a program, and the frames among them.
Page = Parcel | Place | Goal | End | Precedence | Lost

_PAGES = (Parcel, Place, Goal, End)
_COORDINATE = (-131_072, 131_071)
_YAW = (-2048, 2047)
_HEAD = {"identity": (1, n.IDENTITY_MAX), "sequence": (1, n.SEQUENCE_MAX)}
_POSE = {**_HEAD, "x": _COORDINATE, "y": _COORDINATE, "yaw": _YAW}
_LIMITS: dict[type, dict[str, tuple[int, int]]] = {
    Estimate: {
        "x": (-2048, 2047),
        "y": (-2048, 2047),
        "yaw": _YAW,
        "identity": (0, n.IDENTITY_MAX),
        "state": (0, n.UNDER),
        "wants": (0, 255),
        "certainty": (0, 15),
        "hold": (0, n.HOLD_NONE),
        "sequence": (0, n.SEQUENCE_MAX),
        "flags": (0, 7),
    },
    Parcel: {
        **_HEAD,
        "shape": (0, n.DISC),
        "length": (0, 4095),
        "width": (0, 4095),
        "acceleration": (1, 255),
        "speed": (1, 255),
        "flags": (0, 63),
    },
    Place: _POSE,
    Goal: {**_POSE, "leg": (0, n.JOINS), "legs": (0, n.LEGS_MAX)},
    End: _HEAD,
    Precedence: {"number": (0, p.NUMBERS - 1), "column": (1, 255), "row": (1, 255)},
    Lost: {
        "kind": (lost.DECLARED, lost.REVOKED),
        "column": (1, 255),
        "row": (1, 255),
        "identity": (1, n.IDENTITY_MAX),
        "number": (1, lost.NUMBER_MAX),
    },
}


def encode_estimate(estimate: Estimate) -> bytes:
    """The data of an estimate's frame; raises OutOfRangeError."""
    _check(estimate)
    frame = bytearray(n.LENGTH)
    n.pack_estimate(tuple(estimate), frame, 0)
    return bytes(frame)


def decode_estimate(data: bytes) -> Estimate | None:
    """The estimate that a frame carries, None if it carries none."""
    fields = array("i", bytes(4 * n.ESTIMATE_FIELDS))
    return Estimate(*fields) if n.unpack_estimate(data, fields) else None


def encode_page(page: Page) -> bytes:
    """The data of a page's frame; raises OutOfRangeError."""
    _check(page)
    if isinstance(page, Precedence):
        _check_identities(page.identities)
        return p.pack_precedence(*page)
    if isinstance(page, Lost):
        return lost.pack_lost(*page)
    if isinstance(page, Goal) and page.legs < page.leg < n.JOINS:
        raise OutOfRangeError(f"Goal.leg: {page.leg} is not in 0..{page.legs}, and not {n.JOINS}")
    fields = [0] * n.PROGRAM_FIELDS
    number = _PAGES.index(type(page))
    head = (page.identity, number, page.sequence)
    values = (*head, *page[2:])
    fields[: len(values)] = values
    frame = bytearray(n.LENGTH)
    n.pack_program(fields, frame)
    return bytes(frame)


def decode_page(data: bytes) -> Page | None:
    """The page of a program that a frame carries, None if it carries none."""
    if p.is_precedence(data):
        identities = bytes(data[p.FIRST :]).rstrip(b"\0")
        number = data[p.NUMBER] * p.NUMBERS >> 8
        return Precedence(number, data[p.COLUMN], data[p.ROW], tuple(identities))
    if lost.is_lost(data):
        place = data[lost.COLUMN], data[lost.ROW], data[lost.IDENTITY]
        return Lost(lost.kind_of(data), *place, lost.number_of(data))
    fields = array("i", bytes(4 * n.PROGRAM_FIELDS))
    if not n.unpack_program(data, fields):
        return None
    kind = _PAGES[fields[n.PAGE]]
    behind = len(kind._fields) - 2
    return kind(fields[0], fields[2], *fields[3 : 3 + behind])


def _check(message: Estimate | Page) -> None:
    for name, (low, high) in _LIMITS[type(message)].items():
        value = getattr(message, name)
        if not low <= value <= high:
            kind = type(message).__name__
            raise OutOfRangeError(f"{kind}.{name}: {value!r} is not in {low}..{high}")


def _check_identities(identities: tuple[int, ...]) -> None:
    if len(identities) > p.PLACES:
        raise OutOfRangeError(f"Precedence.identities: {len(identities)}, more than {p.PLACES}")
    for identity in identities:
        if not 1 <= identity <= n.IDENTITY_MAX:
            raise OutOfRangeError(
                f"Precedence.identities: {identity!r} is not in 1..{n.IDENTITY_MAX}"
            )
