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

from mdms_protocol.compat import const, micropython, ptr8, ptr16
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours import precedence as frame

_PROMISED = const(2)
_UNDER = const(3)
assert (_PROMISED, _UNDER) == (wire.PROMISED, wire.UNDER)

# Bytes of an order: how many of it have come, how long the last of them has been away, for how many
# beats another has been kept waiting (two bytes each), the frame's byte with the number, identities
_COME = const(0)
_AWAY = const(1)
_KEPT_BEATS = const(3)
_NUMBER = const(5)
FIRST = const(6)
BYTES = const(11)
assert BYTES == FIRST + frame.PLACES

#: A parcel that has left may come back while it turns, and has gone only after so many beats in
#: which it is under a neighbour, or a twelfth of that elsewhere.
_GONE = const(500)
_ELSEWHERE = const(12)
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
def turn(order: ptr8, here: int, state: int, estimates: ptr16, fresh: ptr8) -> int:
    """A beat has passed: take in who is here; returns whose turn it is, by place in the order.

    `here` and `state` are what the right of way has decided last.
    """
    places = int(frame.PLACES)
    fields = int(wire.ESTIMATE_FIELDS)
    identity_at = int(wire.IDENTITY)
    state_at = int(wire.STATE)
    come = order[_COME]
    last = order[FIRST + come - 1] if come else 0
    away = order[_AWAY] | order[_AWAY + 1] << 8
    if last and here == last and state >= _PROMISED and away < _GONE:
        away = 0
    else:
        passing = _ELSEWHERE
        for direction in range(8):
            its = estimates[fields * direction + identity_at]
            its_state = estimates[fields * direction + state_at]
            if fresh[direction] and its == last and its_state == _UNDER:
                passing = 1
        away = away + passing if away + passing < _GONE else _GONE
        place = come if state == _UNDER else places
        while place < places and order[FIRST + place] != here:
            place += 1
        if place < places:
            # Whoever was to come before it has been here, or comes no more.
            come = place + 1
            away = 0
            order[_COME] = come
            order[_KEPT_BEATS] = 0
            order[_KEPT_BEATS + 1] = 0
    order[_AWAY] = away & 0xFF
    order[_AWAY + 1] = away >> 8
    return come - 1 if come and away < _GONE else come


@micropython.viper
def keep(order: ptr8, now: int, estimates: ptr16, fresh: ptr8):
    """Let no parcel ask for this cell whose turn is after the one that is `now`.

    Its fresh estimates want it no more. Whoever it waits for in vain is passed over.
    """
    places = int(frame.PLACES)
    fields = int(wire.ESTIMATE_FIELDS)
    identity_at = int(wire.IDENTITY)
    wants_at = int(wire.WANTS)
    kept = 0
    for direction in range(8):
        its = estimates[fields * direction + identity_at]
        place = now
        while place < places and order[FIRST + place] != its:
            place += 1
        own = 1 << (direction ^ 4)
        wants = estimates[fields * direction + wants_at]
        if fresh[direction] and place > now and place < places and wants & own:
            kept = 1
            estimates[fields * direction + wants_at] = wants ^ own
    if kept:
        beats = (order[_KEPT_BEATS] | order[_KEPT_BEATS + 1] << 8) + 1
        if beats >= _PATIENCE_BEATS:
            order[_COME] += 1
            order[_AWAY] = _GONE & 0xFF
            order[_AWAY + 1] = _GONE >> 8
            beats = 0
        order[_KEPT_BEATS] = beats & 0xFF
        order[_KEPT_BEATS + 1] = beats >> 8
