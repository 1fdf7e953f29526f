"""Decides which parcel a cell belongs to, whom it promises itself to, and whether it may drive.

Pure: no clock, no bus, integers only. The layer passes every estimate that a neighbour sent to
`on_message`, calls `on_beat` once after each SYNC, and sends `identity`, `state` and `hold` in
its estimate at the next SYNC.

Each cell is the only arbiter of itself. Time is counted in beats, and estimates carry no number:
whatever a neighbour said is taken as said at most `late_beats` SYNCs ago, so that it counts from
its arrival for `lease_beats - late_beats` beats and never beyond `lease_beats` after it was sent.
A cell that stopped announcing a promise makes none to another parcel before every wheel that may
have turned by it stands: the lease, and the time that `hold` takes to the last cell under the
parcel. After a reset it cannot tell whom it was promised to, and waits as long.
"""

NONE = 0
NEAR = 1
PROMISED = 2
UNDER = 3

#: `hold` counts steps from a cell that lacks a promise, up to this, which stands for none.
CLEAR = 5
#: The most steps between two cells under one parcel.
HOPS = 4

DIRECTIONS = 8


class RightOfWay:
    """Promises, leases and identity of one cell.

    `lease_beats`: how long a promise counts after the SYNC it was sent at.
    `late_beats`: an estimate is passed to `on_message` before the update that follows the
    `late_beats`-th SYNC after its own (1: never later than the next beat's update).
    `hold_beats`: for how many beats a neighbour's `hold` counts after its arrival.
    `hops`: the most steps between two cells under one parcel; at most HOPS.
    `patience_beats`: how long a parcel that is held elsewhere keeps a promise that another wants;
    a quarter of it if the other's identity is lower.
    `blocked_beats`: how long a promise is lacked until `blocked` is set.

    To be sent: `identity`, `state`, `hold`. For the wheels: `drive_beats`, the number of beats
    for which they may turn without another update (0: they may not). To be reported: `blocked`;
    `lacking`, the mask of neighbours whose promise is wanted and not held.
    """

    def __init__(
        self,
        lease_beats=10,
        late_beats=2,
        hold_beats=3,
        hops=HOPS,
        patience_beats=100,
        blocked_beats=100,
    ):
        self._valid_beats = lease_beats - late_beats
        self._stale_beats = max(0, self._valid_beats - hold_beats)
        self._bound_beats = lease_beats + hops * (late_beats + hold_beats)
        self._patience_beats = patience_beats
        self._blocked_beats = blocked_beats
        self._identities = bytearray(DIRECTIONS)
        self._states = bytearray(DIRECTIONS)
        self._wishes = bytearray(DIRECTIONS)
        self._holds = bytearray(DIRECTIONS)
        self._left = bytearray(DIRECTIONS)
        self.restart()

    def restart(self):
        """Begin after a reset: belong to no parcel, and be silent about promises for a while."""
        self.identity = 0
        self.state = NONE
        self.hold = CLEAR
        self.drive_beats = 0
        self.lacking = 0
        self.blocked = False
        self._promised = 0  # identity that this cell is bound to, announced or not; 0: nobody's
        self._bound = self._bound_beats + 1  # beats until another may be promised
        self._last = 0  # identity that goes last where several ask
        self._waiting = 0  # beats for which the one promised to has been held, and another asks
        self._lacked = 0  # beats for which a promise has been lacked
        self.void()

    def void(self):
        """Drop all that neighbours said."""
        for direction in range(DIRECTIONS):
            self._left[direction] = 0

    def on_gap(self):
        """A SYNC passed without an update of its own: what neighbours said may be of any age."""
        self.void()
        self.drive_beats = 0
        if self._bound:
            self._bound = self._bound_beats + 1

    def on_message(self, direction, identity, state, wants_me, hold):
        """The neighbour in this direction sent this estimate, at most `late_beats` SYNCs ago."""
        self._identities[direction] = identity
        self._states[direction] = state if identity else NONE
        self._wishes[direction] = 1 if wants_me else 0
        self._holds[direction] = hold if hold <= CLEAR else 0
        self._left[direction] = self._valid_beats

    def on_beat(self, over, wants, occupied):
        """Decide for the next beat.

        `over`: identity of the parcel whose outline is over this cell by its own belief, or 0;
        `wants`: mask of the neighbours which that parcel covers or needs next, as seen from here;
        `occupied`: a presence sensor of this cell is covered.
        """
        if self.state >= PROMISED:
            self._bound = self._bound_beats
        elif self._bound:
            self._bound -= 1
            if not self._bound:
                self._promised = 0
        if over:
            self._be_under(over)
        elif self.state >= PROMISED and self._keeps():
            self.identity = self._promised
            self.state = PROMISED
        else:
            self._be_free(occupied)
        self._clear_the_wheels(wants)
        for direction in range(DIRECTIONS):
            if self._left[direction]:
                self._left[direction] -= 1

    def _be_under(self, identity):
        """A parcel stands here, promised to or not; it drives once nobody else may."""
        self._waiting = 0
        self.identity = identity
        if self._promised == identity or not self._bound:
            self._promise(identity)
            self._last = identity
            self.state = UNDER
        else:
            self.state = NEAR

    def _promise(self, identity):
        self._promised = identity
        self._bound = self._bound_beats

    def _keeps(self):
        """Whether the promise that is announced is to be announced again."""
        if not self._asks(self._promised):
            return False
        other = self._asker(self._promised)
        if not other or not self._is_held(self._promised):
            self._waiting = 0
            return True
        self._waiting += 1
        if self._waiting >= self._patience_beats or (
            other < self._promised and self._waiting >= self._patience_beats >> 2
        ):
            self._last = self._promised
            return False
        return True

    def _be_free(self, occupied):
        """No parcel stands here by belief, and no promise is announced: find whom to promise to.

        What covers a sensor and belongs to nobody keeps everybody away.
        """
        self._waiting = 0
        asker = self._asker(self._last) or self._asker(0)
        if asker and (asker == self._promised or not (self._bound or occupied)):
            self._promise(asker)
            self.identity = asker
            self.state = PROMISED
        else:
            self.identity = self._nearest()
            self.state = NEAR if self.identity else NONE

    def _is_asking(self, direction):
        return (
            self._left[direction] and self._states[direction] == UNDER and self._wishes[direction]
        )

    def _asks(self, identity):
        for direction in range(DIRECTIONS):
            if self._is_asking(direction) and self._identities[direction] == identity:
                return True
        return False

    def _asker(self, excluded):
        """The lowest identity that asks, but for one; 0 if there is none."""
        lowest = 0
        for direction in range(DIRECTIONS):
            if self._is_asking(direction):
                identity = self._identities[direction]
                if identity != excluded and (not lowest or identity < lowest):
                    lowest = identity
        return lowest

    def _is_held(self, identity):
        """Whether the parcel stands for want of a promise, by all of its cells that ask here."""
        for direction in range(DIRECTIONS):
            if (
                self._is_asking(direction)
                and self._identities[direction] == identity
                and self._holds[direction] == CLEAR
            ):
                return False
        return True

    def _nearest(self):
        """The identity of a neighbour that a parcel stands on; its own as long as there is one."""
        nearest = 0
        for direction in range(DIRECTIONS):
            if self._left[direction] and self._states[direction] == UNDER:
                identity = self._identities[direction]
                if identity == self.identity:
                    return identity
                nearest = nearest or identity
        return nearest

    def _clear_the_wheels(self, wants):
        """Find out whether all that the parcel covers or needs is promised, here and around."""
        lacking = 0
        hold = CLEAR
        drive_beats = self._valid_beats
        if self.state == UNDER:
            for direction in range(DIRECTIONS):
                left = self._left[direction]
                if not (
                    left
                    and self._identities[direction] == self.identity
                    and self._states[direction] >= PROMISED
                ):
                    lacking |= wants & (1 << direction)
                    continue
                if self._states[direction] == UNDER:
                    left = max(0, left - self._stale_beats)
                    hold = min(hold, 1 + (self._holds[direction] if left else 0))
                if wants & (1 << direction):
                    drive_beats = min(drive_beats, left)
        else:
            drive_beats = 0
        self.lacking = lacking
        self.hold = 0 if lacking else hold
        self.drive_beats = drive_beats if self.hold == CLEAR else 0
        self._lacked = min(self._lacked + 1, self._blocked_beats) if lacking else 0
        self.blocked = self._lacked >= self._blocked_beats
