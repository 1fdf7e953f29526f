"""A lost cell, as host and neighbours agree on it: a frame for the up to eight cells around it.

It comes among the pages of programs, and is of no parcel's program: bytes 0 and 1, an identity and
a column elsewhere, have 0 there. The upper two bits of byte 0 are the kind. Bytes 2 and 3 are the
column and the row of the lost cell, both from 1. Byte 4 is the identity of the only parcel that may
cross its square. Bytes 5 and 6 are the number of the round, and byte 7 is 0. Neighbours answer with
the same frame and another kind, in their own frames of programs.
"""

from mdms_protocol.compat import const
from mdms_protocol.neighbours.frames import IDENTITY_MAX, LENGTH

try:
    from typing import TYPE_CHECKING
except ImportError:
    TYPE_CHECKING = False  # type: ignore[misc]
if TYPE_CHECKING:
    from collections.abc import Sequence

# Kinds
DECLARED = const(0)  # by the host: do without this cell
AGREED = const(1)  # by a neighbour
REFUSED = const(2)  # by a neighbour: it has heard the cell, or keeps its promise to another
REVOKED = const(3)  # by the host: the cell takes part again; the neighbour returns it

#: A cell is lost after such a silence [beats]. By then no cell that is cut off drives: its watchdog
#: (0.5 s on the slowest board), its setpoint time (50 ms) and its lease (100 ms) have ended.
LOST_BEATS = const(200)
#: Of a lease, so many beats are for a round: from the host's page until all have agreed.
ROUND_BEATS = const(4)
NUMBER_MAX = const(0xFFFF)

_KIND = const(0)
_ZERO = const(1)
COLUMN = const(2)
ROW = const(3)
IDENTITY = const(4)
_NUMBER = const(5)
_LAST = const(7)
_KIND_BIT = const(6)


def pack_lost(kind: int, column: int, row: int, identity: int, number: int) -> bytes:
    """The data of the frame."""
    low, high = number & 0xFF, number >> 8
    return bytes((kind << _KIND_BIT, 0, column, row, identity, low, high, 0))


def is_lost(frame: "Sequence[int]") -> bool:
    """Whether a frame is one: of a cell, a parcel and a round."""
    if len(frame) != LENGTH or frame[_KIND] & IDENTITY_MAX or frame[_ZERO] or frame[_LAST]:
        return False
    there = frame[COLUMN] and frame[ROW] and number_of(frame)
    return bool(there) and 0 < frame[IDENTITY] <= IDENTITY_MAX


def kind_of(frame: "Sequence[int]") -> int:
    """The kind of a frame that is one."""
    return int(frame[_KIND] >> _KIND_BIT)


def number_of(frame: "Sequence[int]") -> int:
    """The number of its round."""
    return int(frame[_NUMBER] | frame[_NUMBER + 1] << 8)
