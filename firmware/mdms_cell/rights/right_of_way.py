"""Decides the parcel that a cell belongs to, its promise to a parcel, and whether it may drive.

Pure: no clock, no bus, integers only. The layer passes every estimate of a neighbour to
`on_estimates`. It calls `on_beat` once after each SYNC. It sends `identity`, `state` and `hold` in
its estimate at the next SYNC.

Each cell is the only arbiter of itself. Time is counted in beats, and estimates carry no number. An
estimate is taken as sent at most `late_beats` SYNCs ago. So it counts from its arrival for
`lease_beats - late_beats` beats, and never beyond `lease_beats` after it was sent.

A cell that has stopped announcing a promise waits before it makes one to another parcel. Every
wheel that may have turned by the old promise must stand by then. That takes the lease, and the time
in which `hold` reaches the last cell under the parcel. After a reset the cell has no record of its
promise, and waits as long. Nor does it know the parcel over its square. Until its first promise it
goes by the reports of its neighbours (`hear`), and only from when every parcel stands that it may
have let come. It promises nothing while a neighbour that lives has not been heard.
"""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from array import array

from mdms_cell.rights.declarations import LostNeighbours
from mdms_protocol.compat import const, micropython, ptr8, ptr16
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours.lost import LOST_BEATS

NONE = const(0)
NEAR = const(1)
PROMISED = const(2)
UNDER = const(3)

#: `hold` counts steps from a cell that lacks a promise, up to this, which stands for none.
CLEAR = const(5)
#: The most steps between two cells under one parcel.
HOPS = const(4)

DIRECTIONS = const(8)

# Registers of a cell. To be sent:
IDENTITY = const(0)
STATE = const(1)
HOLD = const(2)
# For the wheels, and for the way ahead:
DRIVE_BEATS = const(3)
LACKING = const(4)
# Its memory:
PROMISED_TO = const(5)  # identity that this cell is bound to, announced or not; 0: unknown
_PREVIOUS = const(6)  # the same, as it was before the present beat
BOUND = const(7)  # beats until another may be promised
WAITING = const(8)  # beats for which the one promised to is held while another asks
_NEAR = const(9)  # identity of a parcel on a neighbour
_NEAR_LEFT = const(10)
# Its times:
_VALID_BEATS = const(11)
_STALE_BEATS = const(12)
_BOUND_BEATS = const(13)
_HOPS = const(14)
_PATIENCE_BEATS = const(15)
_REGISTERS = const(16)

# Reports of neighbours that count, a column of each by direction: identity, state, hold, and the
# beats for which it still counts
IDENTITIES = const(0)
STATES = const(8)
HOLDS = const(16)
LEFT = const(24)
_COLUMNS = const(32)


#: A sensor of the cell is covered by something else than the parcel that is to come.
BY_ANOTHER = const(2)
#: In the place of an identity: neighbours differ, or may live and have not been heard.
UNKNOWN = const(255)
#: Added to an identity: a neighbour reports that parcel, and not whether it lies here.
UNPLACED = const(128)
#: A neighbour that has been silent for so long is dead [beats].
DEAD_BEATS = LOST_BEATS


class RightOfWay:
    """Promises, leases and identity of one cell, in its `registers`.

    `lease_beats`: how long a promise counts after the SYNC it was sent at.
    `late_beats`: an estimate is passed to `on_estimates` before the update that follows the
    `late_beats`-th SYNC after its own (1: no later than the next beat's update).
    `hold_beats`: for how many beats a neighbour's `hold` counts after its arrival.
    `hops`: the most steps between two cells under one parcel; at most HOPS.
    `patience_beats`: how long a parcel that is held elsewhere keeps a promise that another wants;
    a quarter of it if the other's identity is lower.

    To be sent: `identity`, `state`, `hold`. For the wheels: `drive_beats`, the number of beats
    for which they may turn without another update (0: they may not). For the way ahead: `lacking`,
    the mask of neighbours whose promise is wanted and not held. `unsure` is whether the
    cell has promised nothing since its restart, or only to a parcel whose place it has not heard.
    """

    def __init__(
        self, *, lease_beats=10, late_beats=2, hold_beats=3, hops=HOPS, patience_beats=100
    ):
        registers = self.registers = array("H", [0] * _REGISTERS)
        registers[_HOPS] = hops
        registers[_PATIENCE_BEATS] = patience_beats
        self.said = bytearray(_COLUMNS)
        self.lost = LostNeighbours()
        self.unsure = False
        self._neighbours = 0
        #: Reports of neighbours may have been sent before all parcels stood, for so many beats.
        self.unheeded_beats = 0
        self.silent_beats = bytearray(DIRECTIONS)
        self.reported = bytearray(DIRECTIONS)
        self.set_lease(lease_beats, late_beats, hold_beats)
        self.restart()

    def set_lease(self, lease_beats, late_beats=2, hold_beats=3):
        """Set how long promises count; a restart is to follow."""
        registers = self.registers
        self._late_beats = late_beats
        valid_beats = registers[_VALID_BEATS] = lease_beats - late_beats
        registers[_STALE_BEATS] = max(0, valid_beats - hold_beats)
        registers[_BOUND_BEATS] = lease_beats + registers[_HOPS] * (late_beats + hold_beats)
        self.lost.set_lease(lease_beats)

    def restart(self, neighbours=0):
        """Begin after a reset: belong to no parcel, and be silent about promises for a while.

        `neighbours` is the mask of those that there are, and that are to be heard before.
        """
        self.unsure = True
        self.lost.reset()
        self._neighbours = neighbours
        registers = self.registers
        for direction in range(DIRECTIONS):
            self.silent_beats[direction] = registers[_VALID_BEATS]
            self.reported[direction] = 0
        for number in range(_VALID_BEATS):
            registers[number] = 0
        registers[HOLD] = CLEAR
        registers[BOUND] = registers[_BOUND_BEATS] + 1  # beats; the last promise is unknown
        self.unheeded_beats = registers[BOUND] + self._late_beats
        self._drop_others()

    @property
    def identity(self):
        """The parcel that the cell belongs to, 0 for none."""
        return self.registers[IDENTITY]

    @property
    def state(self):
        """NONE, NEAR, PROMISED or UNDER."""
        return self.registers[STATE]

    @property
    def hold(self):
        """How many steps it is to a cell that lacks a promise; CLEAR for none."""
        return self.registers[HOLD]

    @property
    def drive_beats(self):
        """For how many beats the wheels may turn."""
        return self.registers[DRIVE_BEATS]

    @property
    def lacking(self):
        """The mask of neighbours whose promise is wanted and not held."""
        return self.registers[LACKING]

    def on_gap(self):
        """A SYNC passed without an update of its own: what neighbours said may be of any age."""
        registers = self.registers
        for direction in range(DIRECTIONS):
            self.said[LEFT + direction] = 0
            silent_beats = self.silent_beats[direction]
            self.silent_beats[direction] = max(silent_beats, registers[_VALID_BEATS])
        self.unheeded_beats = registers[_BOUND_BEATS] + 1 + self._late_beats
        self.lost.on_gap()
        registers[DRIVE_BEATS] = 0
        self.on_deaf_beat()

    def on_deaf_beat(self):
        """No neighbour was heard in a beat: what this cell has announced may still be on its way.

        A cell that is cut off alone goes on sending until others hear it again. So its promise
        lasts from then on as if it was announced then.
        """
        registers = self.registers
        if registers[BOUND]:
            registers[BOUND] = registers[_BOUND_BEATS] + 1

    @micropython.native
    def on_estimates(self, estimates, fresh):
        """Take the estimates of neighbours, at most `late_beats` SYNCs old: a row by direction.

        A cell under a parcel counts the cells of the same parcel, and promises to it. Any other
        cell counts the cells under a parcel that want it. Return the mask of the fresh estimates;
        none is fresh after this. Estimates of lost neighbours are dropped.
        """
        if self.lost.mask:
            for direction in range(DIRECTIONS):
                if self.lost.mask >> direction & 1:
                    fresh[direction] = 0
        return _take_in(self.registers, self.said, estimates, fresh)

    def hear(self, direction, over):
        """Hear a neighbour in this beat, which counts while the cell is `unsure`.

        `over` is the parcel that it reports over this cell's square. It is 0 for none. UNPLACED is
        added for a parcel whose place cannot be told.
        """
        if self.unheeded_beats == 0:
            self.silent_beats[direction] = 0
            self.reported[direction] = over

    def do_without(self, direction, identity, number, silent_beats):
        """The host declares a neighbour lost for this parcel; return whether the cell agrees.

        It agrees if that neighbour has been silent for long, and the cell itself is promised to the
        parcel: then no other parcel comes to the lost cell's square by way of this one.
        """
        promised = self.registers[STATE] >= PROMISED
        agrees = self.lost.declare(
            direction,
            identity,
            number,
            silent_beats=silent_beats,
            promised_to=self.registers[IDENTITY] if promised else 0,
        )
        # At once, so that the promise which it agrees by does not end with this beat.
        self._speak_for_the_lost()
        return agrees

    def readmit(self, direction):
        """The host has revoked the declaration: that neighbour speaks for itself again."""
        self.lost.revoke(direction)
        self.said[LEFT + direction] = 0

    def approach(self, identity):
        """Be near this parcel, for something of it is to be known."""
        self.registers[_NEAR] = identity
        self.registers[_NEAR_LEFT] = self.registers[_VALID_BEATS]

    @micropython.native
    def on_beat(self, over, wants, occupied):
        """Decide for the next beat.

        `over`: identity of the parcel whose outline is over this cell by its own belief, or 0;
        `wants`: mask of the neighbours which that parcel covers or needs next, as seen from here;
        `occupied`: whether a presence sensor of this cell is covered, or BY_ANOTHER.
        """
        registers, said = self.registers, self.said
        here = 0
        if self.unsure:
            here = self._by_report(over)
            if over != here:
                if over and (not registers[_NEAR] or registers[_NEAR] == over):
                    self.approach(over)
                over = 0
        if not _stays_under(registers, said, over):
            self._change(over, occupied, here)
            if registers[STATE] >= PROMISED and here < UNPLACED:
                # From now on the cell knows the parcel that it lets come.
                self.unsure = False
        if self.lost.mask:
            self._speak_for_the_lost()
            self.lost.on_beat()
        _clear_the_wheels(registers, said, wants)

    def _speak_for_the_lost(self):
        """Have lost neighbours speak as the host has declared.

        A lost neighbour counts as under its only parcel: it asks a cell under none, and is promised
        to a cell under that parcel.
        """
        registers, said, lost = self.registers, self.said, self.lost
        parcel = registers[IDENTITY] if registers[STATE] == UNDER else 0
        for direction in range(DIRECTIONS):
            if not lost.mask >> direction & 1:
                continue
            if parcel:
                identity, left = parcel, lost.granted_beats(direction, parcel)
            else:
                # One beat is left when the next decision is made.
                identity, left = lost.asked_for(direction), 2
            said[IDENTITIES + direction] = identity if left else 0
            said[STATES + direction] = PROMISED if parcel else UNDER
            said[HOLDS + direction] = CLEAR
            said[LEFT + direction] = left if identity else 0

    def _by_report(self, over):
        """Pass a beat; return the parcel over the square by neighbours, UNKNOWN if they differ.

        It is UNKNOWN too if one of them has not been heard, and may live. A parcel that is only
        reported UNPLACED is returned so.
        """
        if self.unheeded_beats:
            self.unheeded_beats -= 1
        here = over
        for direction in range(DIRECTIONS):
            silent_beats = self.silent_beats[direction]
            if silent_beats < DEAD_BEATS:
                self.silent_beats[direction] = silent_beats + 1
            if not self._neighbours >> direction & 1:
                continue
            if self.registers[_VALID_BEATS] <= silent_beats < DEAD_BEATS:
                here = UNKNOWN
            reported = self.reported[direction]
            if reported and (here ^ reported) & ~UNPLACED:
                here = UNKNOWN if here else reported
            elif reported:
                # One that knows the place is enough.
                here &= reported
        return here

    def _change(self, over, occupied, here):
        """The cell is not under the parcel that it is promised to, or was not before."""
        registers = self.registers
        before = registers[STATE]
        if over:
            self._be_under(over)
        elif before >= PROMISED and occupied != BY_ANOTHER and self._keeps():
            registers[IDENTITY] = registers[PROMISED_TO]
            registers[STATE] = PROMISED
        else:
            self._be_free(occupied, here)
        if (before == UNDER) != (registers[STATE] == UNDER):
            self._drop_others()

    def _drop_others(self):
        """Drop what neighbours said, but for those of the same parcel."""
        said = self.said
        for direction in range(DIRECTIONS):
            if said[IDENTITIES + direction] != self.identity:
                said[IDENTITIES + direction] = 0
                said[LEFT + direction] = 0

    def _be_under(self, identity):
        """A parcel stands here, promised to or not; it drives once no other may come."""
        registers = self.registers
        registers[WAITING] = 0
        registers[_NEAR] = registers[IDENTITY] = identity
        registers[_NEAR_LEFT] = registers[_VALID_BEATS]
        registers[STATE] = NEAR
        if registers[PROMISED_TO] == identity or not registers[BOUND]:
            self._promise(identity)
            registers[STATE] = UNDER

    def _promise(self, identity):
        registers = self.registers
        registers[PROMISED_TO] = identity
        registers[BOUND] = registers[_BOUND_BEATS]

    def _keeps(self):
        """Whether the promise that is announced is to be announced again."""
        registers = self.registers
        promised = registers[PROMISED_TO]
        if not self._asks(promised):
            return False
        other = self._asker(promised)
        if not other or not self._is_held(promised):
            registers[WAITING] = 0
            return True
        registers[WAITING] += 1
        patience_beats = registers[_PATIENCE_BEATS]
        return registers[WAITING] < (patience_beats >> 2 if other < promised else patience_beats)

    def _be_free(self, occupied, here):
        """Promise the cell to the best request: no parcel stands here, and no promise is kept.

        The parcel that had the promise before goes last. A covered sensor that belongs to no parcel
        keeps all others away. BY_ANOTHER keeps the promised one away too. A parcel that is `here`
        by report keeps all others away. If it is UNPLACED, a covered sensor keeps it away as well,
        since another thing may lie there.
        """
        registers = self.registers
        registers[WAITING] = 0
        keeps = occupied != BY_ANOTHER
        asker = self._asker(registers[_PREVIOUS]) or self._asker(0)
        bound = registers[BOUND]
        if here:
            identity = here & ~UNPLACED
            asker = identity if self._asks(identity) else 0
            occupied = occupied and identity != here
        if asker and ((keeps and asker == registers[PROMISED_TO]) or not (bound or occupied)):
            self._promise(asker)
            registers[IDENTITY] = asker
            registers[STATE] = PROMISED
        else:
            registers[IDENTITY] = registers[_NEAR]
            registers[STATE] = NEAR if registers[_NEAR] else NONE

    def _says(self, direction):
        """The identity that counts of this direction; 0 if none does."""
        return self.said[IDENTITIES + direction] if self.said[LEFT + direction] else 0

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
            if self._says(direction) == identity and self.said[HOLDS + direction] == CLEAR:
                return False
        return True


@micropython.viper
def _take_in(registers: ptr16, said: ptr8, estimates: ptr16, fresh: ptr8) -> int:
    """Keep what counts of the fresh estimates, and which parcel is near a cell under none.

    Returns the mask of their directions.
    """
    fields = int(wire.ESTIMATE_FIELDS)
    identity_at = int(wire.IDENTITY)
    state_at = int(wire.STATE)
    hold_at = int(wire.HOLD)
    wants_at = int(wire.WANTS)
    parcel = registers[IDENTITY] if registers[STATE] == UNDER else 0
    counts_beats = registers[_VALID_BEATS] + 1
    taken = 0
    at = 0
    for direction in range(DIRECTIONS):
        if fresh[direction]:
            fresh[direction] = 0
            taken |= 1 << direction
            identity = estimates[at + identity_at]
            state = estimates[at + state_at]
            hold = estimates[at + hold_at]
            if parcel:
                counts = identity == parcel and state >= PROMISED
            else:
                asks = identity != 0 and state == UNDER
                counts = asks and estimates[at + wants_at] >> (direction ^ 4) & 1 == 1
                near = registers[_NEAR]
                if asks and (near == 0 or near == identity):  # noqa: PLR1714 - viper has no tuples
                    registers[_NEAR] = identity
                    registers[_NEAR_LEFT] = counts_beats
            said[IDENTITIES + direction] = identity if counts else 0
            said[STATES + direction] = state
            said[HOLDS + direction] = hold if hold <= CLEAR else 0
            said[LEFT + direction] = counts_beats if counts else 0
        at += fields
    return taken


@micropython.viper
def _stays_under(registers: ptr16, said: ptr8, over: int) -> bool:
    """A beat has passed; returns whether the cell stays under the parcel that it is promised to."""
    for direction in range(DIRECTIONS):
        if said[LEFT + direction]:
            said[LEFT + direction] -= 1
    registers[_PREVIOUS] = registers[PROMISED_TO]
    if registers[STATE] >= PROMISED:
        registers[BOUND] = registers[_BOUND_BEATS]
    elif registers[BOUND]:
        registers[BOUND] -= 1
        if registers[BOUND] == 0:
            registers[PROMISED_TO] = 0
    if registers[STATE] == UNDER and registers[PROMISED_TO] == over:
        registers[_NEAR] = over
        registers[_NEAR_LEFT] = registers[_VALID_BEATS]
        return True
    if registers[_NEAR_LEFT]:
        registers[_NEAR_LEFT] -= 1
    if registers[_NEAR_LEFT] == 0:
        registers[_NEAR] = 0
    return False


@micropython.viper
def _clear_the_wheels(registers: ptr16, said: ptr8, wants: int):
    """Find out whether all that the parcel covers or needs is promised, here and around."""
    lacking = drive_beats = 0
    hold = CLEAR
    if registers[STATE] == UNDER:
        hops = registers[_HOPS]
        stale_beats = registers[_STALE_BEATS]
        drive_beats = registers[_VALID_BEATS]
        # How many steps it is to a cell that lacks a promise.
        steps = hops + 1
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
        if lacking:
            hold = drive_beats = 0
        elif steps <= hops:
            hold = steps
            drive_beats = 0
    registers[LACKING] = lacking
    registers[HOLD] = hold
    registers[DRIVE_BEATS] = drive_beats
