"""Neighbours that the host has declared lost: their squares, kept for one parcel by all around.

The host asks in rounds, and each round has a number. A neighbour of the lost cell agrees if it has
not heard that cell for long, and is itself promised to the parcel. The host begins the next round
once all around have agreed. So the next number shows a cell that all had agreed, and the square
counts as promised to the parcel. It counts for a part of a lease after the cell's own agreement.
The host begins a round within the other part of it. So no agreement is ever older than a lease,
whatever delays the frames. A cell that has agreed keeps its own promise for a lease.

The lost cell's own word counts for nothing until the host revokes the declaration: it may come back
with a memory from before.
"""

from array import array

from mdms_protocol.compat import const
from mdms_protocol.neighbours.lost import LOST_BEATS, NUMBER_MAX, ROUND_BEATS

_DIRECTIONS = const(8)
#: In the place of beats since an agreement: there is none.
_NEVER = const(255)


class LostNeighbours:
    """Declarations of the host, by direction; `mask` is that of the directions.

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
        newer = (number - self._numbers[direction]) & NUMBER_MAX
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
