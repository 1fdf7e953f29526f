"""What a cell makes of what it and its neighbours have seen: where the parcel is, how it moves.

A cell under the parcel keeps a belief of its own: it rolls it on by the wheels of its
neighbourhood, corrects it where sensors see an edge, and agrees with the neighbours under the same
parcel. A cell beside the parcel follows those that are under it.
"""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

try:
    import micropython
    from micropython import const
except ImportError:
    from mdms_protocol.cpython import const, micropython, ptr8, ptr32

from mdms_cell.neighbours.agreement import OWN_WEIGHT, Agreement, gather, sum_up
from mdms_cell.neighbours.belief import Belief, agree, roll, send
from mdms_cell.neighbours.geometry.footprint import ALL_WHEELS
from mdms_cell.neighbours.geometry.outline import points_within
from mdms_cell.neighbours.geometry.place import AXES, DIRECTIONS
from mdms_cell.neighbours.heard import NEVER, OWN
from mdms_cell.neighbours.right_of_way import PROMISED, UNDER
from mdms_cell.neighbours.sensors import Sensors
from mdms_cell.neighbours.suspicion import WHEELS
from mdms_cell.neighbours.twist import WHEELS as TWIST_WHEELS
from mdms_cell.neighbours.twist import TwistFit, fit
from mdms_protocol.neighbours import frames as wire

_FEW_WHEELS = const(5)
#: A pose is announced no longer after the SYNC of the belief that it was made of.
_AHEAD_MAX_MS = const(50)
#: A cell beside a parcel follows its neighbours for so long after the last of them.
_FOLLOW_BEATS = const(5)
#: A sensor so far outside is not covered by this parcel, whatever its place is off, 30 mm [steps].
_ELSEWHERE = const(1875)
#: The mask of all directions.
_ALL = (1 << DIRECTIONS) - 1
#: So many neighbours that have the parcel show that a cell's own sensors are wrong.
_WITNESSES = const(2)
#: A cell whose sensors miss the parcel for so long steers no more, and then has it no longer.
DOUBT_BEATS = const(20)
LOST_BEATS = const(100)


class Tracking:
    """The belief of one parcel; `identity` is 0 without one, `missing_beats` since it was seen."""

    def __init__(self, place, footprint, heard, suspicion):
        self._place = place
        self._footprint = footprint
        self._heard = heard
        self._suspicion = suspicion
        self._agreement = Agreement(suspicion)
        # By direction who is at another parcel.
        self._others = bytearray(DIRECTIONS + 1)
        self.belief = Belief()
        self.outline = self.belief.outline
        self.twist = TwistFit(self.outline.registers)
        self.sensors = Sensors(self, footprint, heard, suspicion)
        self.drop()

    def drop(self):
        """There is no parcel."""
        self.identity = 0
        self.shaped = False
        self.under = False
        self.missing_beats = 0
        self._followed_beats = 0
        self._follows = False
        # Whether a pose was sent last, and how certain.
        self._sent = False
        self.sensors.turn = 0
        self.certainty = 0
        self.belief.drop()
        self.twist.reset()
        self._agreement.reset()

    def adopt(self, identity):
        """Follow this parcel from now on."""
        self.drop()
        self.identity = identity

    def take_shape(self, program):
        """The parcel's outline is known now."""
        self.outline.set(*program.size())
        self.shaped = True
        self._look()

    def place(self, x_um, y_um, turn):
        """The parcel was put there [um; from the cell's own centre]."""
        self.belief.start(x_um, y_um, turn)
        self.twist.reset()
        self._look()

    def _look(self):
        self.under = self.shaped and self.belief.known and self._footprint.covers(self.outline)

    @micropython.native
    def update(self, step_ms, sync_ms):
        """Bring the belief to the last SYNC, `step_ms` after that of the last update."""
        heard, sensors = self._heard, self.sensors
        if self.identity and self.shaped:
            registers, out = self.outline.registers, self._suspicion.out
            estimates, beat = heard.estimates, heard.beat
            masks = _sort(
                estimates,
                heard.estimate_beat,
                heard.speeds_beat,
                beat,
                self.identity,
                self._others,
                out,
            )
            self._fit(registers, masks >> DIRECTIONS)
            agreement = self._agreement
            peers, sent = agreement.registers, self._sent
            gather(estimates, self._place.shifts, masks & _ALL, peers, registers)
            # A few wheels, all on one side, do not show how a parcel turns.
            self._follows = follows = not self.under or registers[TWIST_WHEELS] < _FEW_WHEELS
            agrees = sent and not follows
            if not agrees:
                agreement.near = 0
            outvoted = agrees and agreement.is_outvoted()
            if not (follows or outvoted) or not self._follow():
                roll(registers, 2000 // step_ms)
                if agrees and sum_up(peers, out, registers, self.certainty):
                    agree(registers, peers, OWN_WEIGHT)
                self.belief.place()
            if self.under:
                if heard.edges:
                    sensors.take_edges(sync_ms)
                if sensors.check(sync_ms):
                    self.missing_beats = 0
                else:
                    self.missing_beats = min(self.missing_beats + 1, LOST_BEATS)
            else:
                self._look()
        if heard.edges:
            sensors.drop_edges(sync_ms)

    @micropython.native
    def _fit(self, registers, wheels):
        """Find the twist by those wheels that lie under the parcel, by the belief of before."""
        if not self.belief.known:
            self.twist.reset()
            return
        footprint = self._footprint
        xs, ys = footprint.wheel_x, footprint.wheel_y
        wheels &= points_within(registers, xs, ys, ALL_WHEELS, 0, 0, 0)
        fit(registers, xs, ys, footprint.along_x, footprint.along_y, self._heard.speeds, wheels)

    def is_witnessed(self):
        """Whether neighbours have the parcel where this cell believes it."""
        return self._agreement.near >= _WITNESSES

    def is_other(self, direction):
        """Whether that cell's wheels and sensors serve another parcel."""
        return self._others[direction]

    def _follow(self):
        """Take what those under the parcel believe; returns whether there are any."""
        if self._agreement.follow(self.belief):
            self._followed_beats = 0
            return True
        if not self.under:
            self._followed_beats += 1
            if self._followed_beats > _FOLLOW_BEATS:
                self.belief.drop()
        return False

    def is_over(self):
        """Whether the parcel lies over the cell's square; not only over its wheels and sensors."""
        return self.under or (
            self.shaped and self.belief.known and self._footprint.reaches(self.outline)
        )

    def is_of_another(self):
        """Whether something else covers a sensor of the cell: one far from the parcel."""
        if not self._heard.presence[OWN] or not self._suspicion.trusts(OWN):
            return False
        near = self._footprint.within(self.outline, OWN, _ELSEWHERE) >> AXES
        return self._heard.presence[OWN] & ~near != 0

    @micropython.native
    def is_sure(self):
        """Whether this cell has a belief of its own that nothing is against."""
        return (
            self._sent and self.under and not (self.missing_beats or self._agreement.outvoted_beats)
        )

    @micropython.native
    def is_doubtful(self):
        """Whether this cell is not to steer: its own sensors or its neighbours are against it."""
        return self.missing_beats >= DOUBT_BEATS or self._agreement.outvoted_beats >= DOUBT_BEATS

    @micropython.native
    def announce(self, fields, ahead_ms):
        """Write pose and certainty into an estimate, so long after the SYNC of the belief.

        That is no pose where it is too long.
        """
        self.certainty = 0
        self._sent = False
        sure = self.belief.known and self.under and not self._follows
        if sure and ahead_ms <= _AHEAD_MAX_MS:
            self._sent = True
            certainty = send(self.outline.registers, 1000 // ahead_ms, fields)
            if not self.is_doubtful():
                self.certainty = certainty
        fields[wire.CERTAINTY] = self.certainty


@micropython.viper
def _sort(  # noqa: PLR0917 - viper takes words
    estimates: ptr32,
    estimate_beat: ptr32,
    speeds_beat: ptr32,
    beat: int,
    parcel: int,
    others: ptr8,
    out: ptr8,
) -> int:
    """The mask of the directions whose estimate of this parcel came in this beat.

    From bit 8 on that of the wheels whose speeds came in this beat and count, two a direction.
    Marks in `others` who is at another parcel.
    """
    never = int(NEVER)
    fields = int(wire.ESTIMATE_FIELDS)
    identity_at = int(wire.IDENTITY)
    state_at = int(wire.STATE)
    certainty_at = int(wire.CERTAINTY)
    promised = int(PROMISED)
    under = int(UNDER)
    suspected = 1 << int(WHEELS)
    own = int(OWN)
    masks = 0
    at = 0
    for direction in range(own + 1):
        other = 0
        if direction != own:
            came = estimate_beat[direction]
            state = estimates[at + state_at]
            if estimates[at + identity_at] != parcel:
                if came != never and state >= promised:
                    other = 1
            elif came == beat and state == under and estimates[at + certainty_at] > 0:
                masks |= 1 << direction
            others[direction] = other
            at += fields
        if speeds_beat[direction] == beat and not other | out[direction] & suspected:
            masks |= 3 << own + 2 * direction
    return masks
