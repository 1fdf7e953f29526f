"""Decides which parcel a cell belongs to, whom it promises itself to, and whether it may drive.

Pure: no clock, no bus, integers only. The layer passes every estimate that a neighbour sent to
`on_estimates`, calls `on_beat` once after each SYNC, and sends `identity`, `state` and `hold` in
its estimate at the next SYNC.

Each cell is the only arbiter of itself. Time is counted in beats, and estimates carry no number:
whatever a neighbour said is taken as said at most `late_beats` SYNCs ago, so that it counts from
its arrival for `lease_beats - late_beats` beats and never beyond `lease_beats` after it was sent.
A cell that stopped announcing a promise makes none to another parcel before every wheel that may
have turned by it stands: the lease, and the time that `hold` takes to the last cell under the
parcel. After a reset it has no record of whom it was promised to, and waits as long.
"""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

try:
    import micropython
    from micropython import const
except ImportError:
    from mdms_protocol.cpython import const, micropython, ptr8, ptr32

from mdms_protocol.neighbours import frames as wire

NONE = const(0)
NEAR = const(1)
PROMISED = const(2)
UNDER = const(3)

#: `hold` counts steps from a cell that lacks a promise, up to this, which stands for none.
CLEAR = const(5)
#: The most steps between two cells under one parcel.
HOPS = const(4)

DIRECTIONS = const(8)

# What neighbours said that counts, a column of each by direction: identity, state, hold, and for
# how many more beats it does
IDENTITIES = const(0)
STATES = const(8)
HOLDS = const(16)
LEFT = const(24)
_COLUMNS = const(32)


class RightOfWay:
    """Promises, leases and identity of one cell.

    `lease_beats`: how long a promise counts after the SYNC it was sent at.
    `late_beats`: an estimate is passed to `on_estimates` before the update that follows the
    `late_beats`-th SYNC after its own (1: no later than the next beat's update).
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
        *,
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
        self._hops = hops
        self._patience_beats = patience_beats
        self._blocked_beats = blocked_beats
        self._said = bytearray(_COLUMNS)
        self.restart()

    def restart(self):
        """Begin after a reset: belong to no parcel, and be silent about promises for a while."""
        self.identity = 0
        self.state = NONE
        self.hold = CLEAR
        self.drive_beats = 0
        self.lacking = 0
        self.blocked = False
        self._promised = 0  # identity that this cell is bound to, announced or not; 0: unknown
        self._bound = self._bound_beats + 1  # beats until another may be promised
        self._waiting = 0  # beats for which the one promised to is held while another asks
        self._lacked = 0  # beats for which a promise has been lacked
        self._near = 0  # identity of a parcel on a neighbour
        self._near_left = 0
        self._drop_others()

    def on_gap(self):
        """A SYNC passed without an update of its own: what neighbours said may be of any age."""
        for direction in range(DIRECTIONS):
            self._said[LEFT + direction] = 0
        self.drive_beats = 0
        if self._bound:
            self._bound = self._bound_beats + 1

    @micropython.native
    def on_estimates(self, estimates, fresh):
        """What neighbours sent, at most `late_beats` SYNCs ago: a row by direction, where fresh.

        A cell under a parcel counts what cells of the same parcel say, and promises to it; any
        other counts the cells under a parcel that want it.
        """
        under = self.identity if self.state == UNDER else 0
        counts_beats = self._valid_beats + 1
        near = _take_in(estimates, fresh, self._said, under, self._near, counts_beats)
        if near:
            self._near = near
            self._near_left = counts_beats

    @micropython.native
    def on_beat(self, over, wants, occupied):
        """Decide for the next beat.

        `over`: identity of the parcel whose outline is over this cell by its own belief, or 0;
        `wants`: mask of the neighbours which that parcel covers or needs next, as seen from here;
        `occupied`: a presence sensor of this cell is covered.
        """
        before = self.state
        previous = self._promised
        self._count_down()
        if over:
            self._be_under(over)
        elif before >= PROMISED and self._keeps():
            self.identity = self._promised
            self.state = PROMISED
        else:
            self._be_free(previous, occupied)
        if (before == UNDER) != (self.state == UNDER):
            self._drop_others()
        self._clear_the_wheels(wants)

    def _drop_others(self):
        """Drop what neighbours said, but for those of the same parcel."""
        for direction in range(DIRECTIONS):
            if self._said[IDENTITIES + direction] != self.identity:
                self._said[IDENTITIES + direction] = 0
                self._said[LEFT + direction] = 0

    @micropython.native
    def _count_down(self):
        if self.state >= PROMISED:
            self._bound = self._bound_beats
        elif self._bound:
            self._bound -= 1
            if not self._bound:
                self._promised = 0
        _age(self._said)
        if self._near_left:
            self._near_left -= 1
        if not self._near_left:
            self._near = 0

    def _be_under(self, identity):
        """A parcel stands here, promised to or not; it drives once no other may come."""
        self._waiting = 0
        self._near = self.identity = identity
        self._near_left = self._valid_beats
        self.state = NEAR
        if self._promised == identity or not self._bound:
            self._promise(identity)
            self.state = UNDER

    def _promise(self, identity):
        self._promised = identity
        self._bound = self._bound_beats

    def _keeps(self):
        """Whether the promise that is announced is to be announced again."""
        promised = self._promised
        if not self._asks(promised):
            return False
        other = self._asker(promised)
        if not other or not self._is_held(promised):
            self._waiting = 0
            return True
        self._waiting += 1
        patience_beats = self._patience_beats
        return self._waiting < (patience_beats >> 2 if other < promised else patience_beats)

    def _be_free(self, previous, occupied):
        """No parcel stands here by belief, and no promise is to be kept: promise to who asks.

        The parcel that had the promise before goes last. What covers a sensor and belongs to no
        parcel keeps all others away.
        """
        self._waiting = 0
        asker = self._asker(previous) or self._asker(0)
        if asker and (asker == self._promised or not (self._bound or occupied)):
            self._promise(asker)
            self.identity = asker
            self.state = PROMISED
        else:
            self.identity = self._near
            self.state = NEAR if self._near else NONE

    def _says(self, direction):
        """The identity that counts of this direction; 0 if none does."""
        return self._said[IDENTITIES + direction] if self._said[LEFT + direction] else 0

    def _asks(self, identity):
        return any(self._says(direction) == identity for direction in range(DIRECTIONS))

    def _asker(self, excluded):
        """The lowest identity that asks, but for one; 0 if there is none."""
        lowest = 0
        for direction in range(DIRECTIONS):
            identity = self._says(direction)
            if identity and identity != excluded and (not lowest or identity < lowest):
                lowest = identity
        return lowest

    def _is_held(self, identity):
        """Whether the parcel stands for want of a promise, by all of its cells that ask here."""
        for direction in range(DIRECTIONS):
            if self._says(direction) == identity and self._said[HOLDS + direction] == CLEAR:
                return False
        return True

    @micropython.native
    def _clear_the_wheels(self, wants):
        """Find out whether all that the parcel covers or needs is promised, here and around."""
        lacking = drive_beats = 0
        hold = CLEAR
        if self.state == UNDER:
            hops = self._hops
            found = _around(self._said, wants, hops, self._valid_beats, self._stale_beats)
            steps = found >> 8 & 0xFF
            lacking = found & 0xFF
            if lacking:
                hold = 0
            elif steps <= hops:
                hold = steps
            else:
                drive_beats = found >> 16
        self.lacking = lacking
        self.hold = hold
        self.drive_beats = drive_beats
        self._lacked = min(self._lacked + 1, self._blocked_beats) if lacking else 0
        self.blocked = self._lacked >= self._blocked_beats


@micropython.viper
def _take_in(  # noqa: PLR0917 - viper takes words
    estimates: ptr32, fresh: ptr8, said: ptr8, parcel: int, near: int, counts_beats: int
) -> int:
    """Keep what counts of the fresh estimates, for a cell under a parcel or, at 0, under none.

    Returns the identity of the parcel that is near a cell under none, 0 if nobody says so.
    """
    fields = int(wire.ESTIMATE_FIELDS)
    identity_at = int(wire.IDENTITY)
    state_at = int(wire.STATE)
    hold_at = int(wire.HOLD)
    wants_at = int(wire.WANTS)
    seen = 0
    for direction in range(DIRECTIONS):
        if fresh[direction]:
            at = fields * direction
            identity = estimates[at + identity_at]
            state = estimates[at + state_at]
            hold = estimates[at + hold_at]
            if parcel:
                counts = identity == parcel and state >= PROMISED
            else:
                asks = identity != 0 and state == UNDER
                counts = asks and estimates[at + wants_at] >> (direction ^ 4) & 1 == 1
                if asks and (near == 0 or near == identity):  # noqa: PLR1714 - viper has no tuples
                    near = seen = identity
            said[IDENTITIES + direction] = identity if counts else 0
            said[STATES + direction] = state
            said[HOLDS + direction] = hold if hold <= CLEAR else 0
            said[LEFT + direction] = counts_beats if counts else 0
    return seen


@micropython.viper
def _age(said: ptr8):
    """A beat has passed."""
    for direction in range(DIRECTIONS):
        if said[LEFT + direction]:
            said[LEFT + direction] -= 1


@micropython.viper
def _around(said: ptr8, wants: int, hops: int, valid_beats: int, stale_beats: int) -> int:
    """What those around a cell under a parcel say of the parcel.

    A mask of the wanted who have not promised; from bit 8 on how many steps it is to a cell that
    lacks a promise, `hops` + 1 for none; from bit 16 on for how many beats all promises last.
    """
    lacking = 0
    steps = hops + 1
    drive_beats = valid_beats
    for direction in range(DIRECTIONS):
        left = said[LEFT + direction]
        wanted = wants & (1 << direction)
        if left == 0:
            lacking |= wanted
        else:
            if said[STATES + direction] == UNDER:
                left = left - stale_beats if left > stale_beats else 0
                step = 1 + said[HOLDS + direction] if left else 1
                steps = step if step < steps else steps
            if wanted and left < drive_beats:
                drive_beats = left
    return lacking | steps << 8 | drive_beats << 16
