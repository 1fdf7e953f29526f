"""The order in which parcels come over this cell without the host, as the host had planned it.

The host keeps the order itself while it is there: it sets each goal when the way to it is free.
Without it promises alone keep parcels apart. Parcels that have to pass each other could then be
promised cells in an order that leaves both without a way. So a cell that misses the host ignores
the request of a parcel while others of the order are to precede it. That is as if the estimate had
been lost, which breaks no rule of right of way.
"""

from mdms_cell.rights.right_of_way import DIRECTIONS
from mdms_protocol.compat import const
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours import precedence as frame

#: A parcel that has left may come back while it turns, and has gone only after so many beats in
#: which it is under a neighbour, or a twelfth of that elsewhere.
_GONE = const(500)


class Precedence:
    """The order in which parcels come over one cell, if the host has given one."""

    def __init__(self):
        self._identities = bytearray(frame.PLACES)
        self.reset()

    def reset(self):
        """Have no order."""
        self._number = 0
        for place in range(frame.PLACES):
            self._identities[place] = 0
        self._begin()

    def _begin(self):
        #: How many of the order have come, how long the last of them has been away, up to _GONE,
        #: and for how many beats another has been kept waiting.
        self._come = self._away = self._kept_beats = 0

    def exists(self):
        """Whether there is an order."""
        return self._identities[0] != 0

    def take(self, data, column, row):
        """Keep the order in a frame of the host, if it is for the cell at this place.

        A repeated frame changes nothing. Return False for a frame that is no order.
        """
        if not frame.is_precedence(data):
            return False
        if (data[frame.COLUMN], data[frame.ROW]) == (column, row):
            identities = data[frame.FIRST : frame.FIRST + frame.PLACES]
            if self._number != data[frame.NUMBER] or bytes(self._identities) != bytes(identities):
                self._number = data[frame.NUMBER]
                self._identities[:] = identities
                self._begin()
        return True

    def _place_of(self, identity, first):
        """The place of a parcel in the order, from `first` on; PLACES without one."""
        place = first
        while place < frame.PLACES and self._identities[place] != identity:
            place += 1
        return place

    def turn(self, here, state, estimates, fresh):
        """Take in the parcel of this beat; return whose turn it is, by place in the order.

        `here` and `state` are the last decision of the right of way.
        """
        last = self._identities[self._come - 1] if self._come else 0
        if last and here == last and state >= wire.PROMISED and self._away < _GONE:
            self._away = 0
        else:
            passing = 1 if _is_under_any(last, estimates, fresh) else 12
            self._away = min(self._away + passing, _GONE)
            place = self._place_of(here, self._come) if state == wire.UNDER else frame.PLACES
            if place < frame.PLACES:
                # The parcels before it have been here, or come no more.
                self._come = place + 1
                self._away = self._kept_beats = 0
        return self._come - 1 if self._come and self._away < _GONE else self._come

    def keep(self, now, estimates, fresh):
        """Let no parcel ask for this cell before the one whose turn is `now`.

        Its fresh estimates no longer want the cell. If the cell waits for a parcel in vain for
        1500 beats, that parcel is passed over.
        """
        kept = False
        for direction in range(DIRECTIONS):
            at = wire.ESTIMATE_FIELDS * direction
            place = self._place_of(estimates[at + wire.IDENTITY], now)
            own = 1 << (direction ^ 4)
            wants = estimates[at + wire.WANTS]
            if fresh[direction] and now < place < frame.PLACES and wants & own:
                kept = True
                estimates[at + wire.WANTS] = wants ^ own
        if kept:
            self._kept_beats += 1
            if self._kept_beats >= 1500:
                self._come += 1
                self._away = _GONE
                self._kept_beats = 0


def _is_under_any(identity, estimates, fresh):
    """Whether a neighbour has just said that it is under this parcel."""
    for direction in range(DIRECTIONS):
        at = wire.ESTIMATE_FIELDS * direction
        its, state = estimates[at + wire.IDENTITY], estimates[at + wire.STATE]
        if fresh[direction] and its == identity and state == wire.UNDER:
            return True
    return False
