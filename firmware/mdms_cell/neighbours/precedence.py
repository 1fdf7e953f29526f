"""Which parcel comes over this cell before which, as the host had planned it when it was gone.

While the host is there it sees to that itself, for it sets each goal when the way to it is free.
Without it promises alone keep parcels apart, and parcels that have to pass each other would be
promised cells in an order that leaves both without a way. So a cell that misses the host does not
take in that a parcel asks for it which others of the order are to precede: as if that estimate had
been lost, which breaks no rule of right of way.

The order is kept in a few bytes, see `BYTES`.
"""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

try:
    import micropython
    from micropython import const
except ImportError:
    from mdms_protocol.cpython import const, micropython, ptr8, ptr32

from mdms_cell.neighbours import right_of_way
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours import precedence as frame

_PROMISED = const(2)
_UNDER = const(3)
assert (_PROMISED, _UNDER) == (right_of_way.PROMISED, right_of_way.UNDER)

# Bytes of an order: how many of it have come, how long the last of them has been away, for how many
# beats, up to 255 and beyond, another has been kept waiting, the frame's byte with the
# number, and the identities
_COME = const(0)
_AWAY = const(1)
_KEPT_BEATS = const(2)
_KEPT_HIGH = const(3)
_NUMBER = const(4)
FIRST = const(5)
BYTES = const(10)
assert BYTES == FIRST + frame.PLACES

#: A parcel that has left may come back while it turns, and has gone only after so many beats in
#: which it is under a neighbour, or a sixth of that elsewhere.
_GONE = const(250)
_ELSEWHERE = const(6)
#: Others are kept waiting for so long; whoever is to precede them comes no more.
_PATIENCE_BEATS = const(1500)


def take(order, data, column, row):
    """Keep the order that a frame of the host has, if it is for the cell at this column and row.

    One that is repeated changes nothing. Returns False for what is no such frame.
    """
    if not frame.is_precedence(data):
        return False
    if (data[frame.COLUMN], data[frame.ROW]) != (column, row):
        return True
    new = order[_NUMBER] != data[frame.NUMBER]
    if new or any(
        order[FIRST + place] != data[frame.FIRST + place] for place in range(frame.PLACES)
    ):
        clear(order)
        order[_NUMBER] = data[frame.NUMBER]
        for place in range(frame.PLACES):
            order[FIRST + place] = data[frame.FIRST + place]
    return True


def clear(order):
    """Have no order."""
    for place in range(BYTES):
        order[place] = 0


@micropython.viper
def keep(order: ptr8, right: ptr32, estimates: ptr32, fresh: ptr8, alone: int):
    """A beat has passed: take in who is here and, when `alone`, let nobody ask before its turn.

    `right` are the registers of a right of way. A fresh estimate of a parcel whose turn it is not
    asks for this cell no more.
    """
    places = int(frame.PLACES)
    fields = int(wire.ESTIMATE_FIELDS)
    identity_at = int(wire.IDENTITY)
    wants_at = int(wire.WANTS)
    here = right[int(right_of_way.IDENTITY)]
    state = right[int(right_of_way.STATE)]
    come = order[_COME]
    last = order[FIRST + come - 1] if come else 0
    away = order[_AWAY]
    if last and here == last and state >= _PROMISED and away < _GONE:
        away = 0
    else:
        passing = 1 if away < _GONE else 0
        if int(_is_near(estimates, fresh, last)) == 0:
            passing *= _ELSEWHERE
        away = away + passing if away + passing < _GONE else _GONE
        place = come if state == _UNDER else places
        while place < places and order[FIRST + place] != here:
            place += 1
        if place < places:
            # Whoever was to come before it has been here, or comes no more.
            come = order[_COME] = place + 1
            last = here
            away = order[_KEPT_BEATS] = order[_KEPT_HIGH] = 0
    order[_AWAY] = away
    if away == _GONE:
        last = 0
    turn = come - 1 if last else come
    kept = False
    direction = 0 if alone else 8
    while direction < 8:
        its = estimates[fields * direction + identity_at]
        place = turn
        while place < places and order[FIRST + place] != its:
            place += 1
        if turn < place < places and fresh[direction]:
            own = 1 << (direction ^ 4)
            wants = estimates[fields * direction + wants_at]
            kept = kept or wants & own != 0
            estimates[fields * direction + wants_at] = wants & (own ^ 0xFF)
        direction += 1
    if kept:
        beats = (order[_KEPT_BEATS] | order[_KEPT_HIGH] << 8) + 1
        if beats >= _PATIENCE_BEATS:
            order[_COME] += 1
            order[_AWAY] = _GONE
            beats = 0
        order[_KEPT_BEATS] = beats & 0xFF
        order[_KEPT_HIGH] = beats >> 8


@micropython.viper
def _is_near(estimates: ptr32, fresh: ptr8, identity: int) -> bool:
    """Whether a neighbour has just reported that it is under this parcel."""
    at = 0
    for direction in range(8):
        its = estimates[at + int(wire.IDENTITY)]
        if fresh[direction] and its == identity and estimates[at + int(wire.STATE)] == _UNDER:
            return True
        at += int(wire.ESTIMATE_FIELDS)
    return False
