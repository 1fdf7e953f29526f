"""The host's declarations on right of way: the order of parcels, and neighbours that are lost."""

from array import array

from mdms_protocol.compat import const
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours import precedence as frame
from mdms_protocol.neighbours.lost import LOST_BEATS, NUMBER_MAX, ROUND_BEATS

_DIRECTIONS = const(8)
#: In the place of beats since an agreement: there is none.
_NEVER = const(255)
#: A parcel that has left may come back while it turns, and has gone only after so many beats in
#: which it is under a neighbour, or a twelfth of that elsewhere.
_GONE = const(500)


class Precedence:
    """The order in which parcels come over one cell without the host, as the host had planned it.

    The host keeps the order itself while it is there: it sets each goal when the way to it is free.
    Without it promises alone keep parcels apart. Parcels that have to pass each other could then be
    promised cells in an order that leaves both without a way. So a cell that misses the host
    ignores the request of a parcel while others of the order are to precede it. That is as if the
    estimate had been lost, which breaks no rule of right of way.
    """

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
        for direction in range(_DIRECTIONS):
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
    for direction in range(_DIRECTIONS):
        at = wire.ESTIMATE_FIELDS * direction
        its, state = estimates[at + wire.IDENTITY], estimates[at + wire.STATE]
        if fresh[direction] and its == identity and state == wire.UNDER:
            return True
    return False


class LostNeighbours:
    """Neighbours declared lost, by direction: their squares, kept for one parcel by all around.

    The host asks in rounds, and each round has a number. A neighbour of the lost cell agrees if it
    has not heard that cell for long, and is itself promised to the parcel. The host begins the next
    round once all around have agreed. So the next number shows a cell that all had agreed, and the
    square counts as promised to the parcel. It counts for a part of a lease after the cell's own
    agreement. The host begins a round within the other part of it. So no agreement is ever older
    than a lease, whatever delays the frames. A cell that has agreed keeps its own promise for a
    lease.

    The lost cell's own word counts for nothing until the host revokes the declaration: it may come
    back with a memory from before.

    `mask` is that of the directions.
    `granted_beats(direction, identity)` is for how long the square counts as promised to a parcel.
    `asked_for(direction)` is the parcel that is to be promised this cell, 0 for none.
    """

    def __init__(self):
        self._identities = bytearray(_DIRECTIONS)
        self._numbers = array("H", [0] * _DIRECTIONS)
        self._agreed_beats = bytearray(_DIRECTIONS)
        self._granted_beats = bytearray(_DIRECTIONS)
        self._kept_beats = bytearray(_DIRECTIONS)
        self.set_lease(10)
        self.reset()

    def set_lease(self, lease_beats, round_beats=ROUND_BEATS, lost_beats=LOST_BEATS):
        """Set how long an agreement counts, how long a round takes, and when a cell is lost."""
        self._lease_beats = lease_beats
        self._grant_beats = max(0, lease_beats - round_beats)
        self._lost_beats = lost_beats

    def reset(self):
        """No neighbour is declared lost."""
        self.mask = 0
        for direction in range(_DIRECTIONS):
            self.revoke(direction)

    def revoke(self, direction):
        """That neighbour counts again."""
        self.mask &= ~(1 << direction)
        self._identities[direction] = self._numbers[direction] = 0
        self._granted_beats[direction] = self._kept_beats[direction] = 0
        self._agreed_beats[direction] = _NEVER

    def on_gap(self):
        """Beats were missed: agreements may be of any age."""
        for direction in range(_DIRECTIONS):
            self._granted_beats[direction] = 0
            self._agreed_beats[direction] = _NEVER

    def on_beat(self):
        """A beat has passed."""
        for direction in range(_DIRECTIONS):
            if self._granted_beats[direction]:
                self._granted_beats[direction] -= 1
            if self._kept_beats[direction]:
                self._kept_beats[direction] -= 1
            if self._agreed_beats[direction] < _NEVER:
                self._agreed_beats[direction] += 1

    def granted_beats(self, direction, identity):
        """See above."""
        return self._granted_beats[direction] if self._identities[direction] == identity else 0

    def asked_for(self, direction):
        """See above."""
        return self._identities[direction] if self._kept_beats[direction] else 0

    def declare(self, direction, identity, number, *, silent_beats, promised_to):
        """Take a page of the host; return whether the cell agrees.

        The neighbour has been silent for `silent_beats`, and this cell is `promised_to` a parcel.
        """
        newer = (number - self._numbers[direction]) % NUMBER_MAX  # from 1 on, round and round
        if self._numbers[direction] and newer > NUMBER_MAX // 2:
            # A late page of an earlier round.
            return False
        if silent_beats < self._lost_beats:
            self._withdraw(direction)
            return False
        self.mask |= 1 << direction
        if self._identities[direction] != identity:
            if self._kept_beats[direction]:
                return False
            self._withdraw(direction)
            self._identities[direction] = identity
        self._kept_beats[direction] = self._lease_beats
        agreed_beats = self._agreed_beats[direction]
        if promised_to != identity:
            self._withdraw(direction)
        elif newer or agreed_beats == _NEVER:
            if newer == 1 and agreed_beats < self._grant_beats:
                self._granted_beats[direction] = self._grant_beats - agreed_beats
            self._agreed_beats[direction] = 0
        self._numbers[direction] = number
        return promised_to == identity

    def _withdraw(self, direction):
        """Agree no more; this cell's own promise lasts as long as others may count on it."""
        self._granted_beats[direction] = 0
        self._agreed_beats[direction] = _NEVER
