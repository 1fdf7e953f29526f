"""In which order parcels come over a cell, as the host has planned it: a frame for one cell.

It comes among the pages of programs, and is the one of no parcel: byte 0, which begins with an
identity in any page, begins with 0. Its upper two bits are a number that changes with the order, or
with who of it has come. Bytes 1 and 2 are the cell's column and row, both from 1; the identities
follow, the first to come first, and zeros behind the last.
"""

from mdms_protocol.compat import const
from mdms_protocol.neighbours.frames import IDENTITY_MAX, LENGTH

try:
    from typing import TYPE_CHECKING
except ImportError:
    TYPE_CHECKING = False  # type: ignore[misc]
if TYPE_CHECKING:
    from collections.abc import Sequence

NUMBER = const(0)
COLUMN = const(1)
ROW = const(2)
FIRST = const(3)
#: So many identities have room.
PLACES = const(5)

#: Numbers are below this.
NUMBERS = const(4)

_NUMBER_BIT = const(6)


def pack_precedence(number: int, column: int, row: int, identities: "Sequence[int]") -> bytes:
    """The data of the frame, of at most `PLACES` identities."""
    frame = bytearray(LENGTH)
    frame[NUMBER] = number << _NUMBER_BIT
    frame[COLUMN], frame[ROW] = column, row
    for place, identity in enumerate(identities):
        frame[FIRST + place] = identity
    return bytes(frame)


def is_precedence(frame: "Sequence[int]") -> bool:
    """Whether a frame is one: of a cell, and of identities with no gap between."""
    if len(frame) != LENGTH or frame[NUMBER] & IDENTITY_MAX or not frame[COLUMN] or not frame[ROW]:
        return False
    ended = False
    for place in range(FIRST, FIRST + PLACES):
        identity = frame[place]
        if identity > IDENTITY_MAX or (ended and identity):
            return False
        ended = not identity
    return True
