"""What a cell makes of what it and its neighbours have seen: where the parcel is, how it moves.

A cell under the parcel keeps a belief of its own: it rolls it on by the wheels of its
neighbourhood, corrects it where sensors see an edge, and agrees with the neighbours under the same
parcel. A cell beside the parcel follows those that are under it.
"""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from mdms_cell.perception.agreement import OWN_WEIGHT, Agreement, near_mask, sum_up
from mdms_cell.perception.belief import SENT, TURN, Belief, X, Y, agree, roll, send
from mdms_cell.perception.heard import NEVER, OWN
from mdms_cell.perception.outline import place as place_outline
from mdms_cell.perception.place import DIRECTIONS, STEPS
from mdms_cell.perception.sensors import Sensors, checker
from mdms_cell.perception.suspicion import WHEELS
from mdms_cell.perception.twist import WHEELS as TWIST_WHEELS
from mdms_cell.perception.twist import fit
from mdms_protocol.compat import const, micropython, ptr8, ptr16, ptr32
from mdms_protocol.neighbours import frames as wire

_FEW_WHEELS = const(5)
#: A pose is announced no longer after the SYNC of the belief that it was made of.
_AHEAD_MAX_MS = const(50)
#: A cell beside a parcel follows its neighbours for so long after the last of them.
_FOLLOW_BEATS = const(5)
# What is used in every beat; constants of another module would be looked up.
_OWN = const(8)
_DIRECTIONS = const(8)
_OTHERS = const(17)
_ALL = const(255)  # the mask of all directions
_CELLS = const(511)  # and of the cell itself
_NEVER = const(1 << 24)
_FIELDS = const(10)
_IDENTITY = const(3)
_STATE = const(4)
_CERTAINTY = const(6)
_PROMISED = const(2)
_UNDER = const(3)
_WHEEL = const(1)
_WHEELS_SHOWN = const(26)
_OWN_WEIGHT = const(1280)
assert (_OWN, _DIRECTIONS, _NEVER) == (OWN, DIRECTIONS, NEVER)
assert (_FIELDS, _IDENTITY, _STATE) == (wire.ESTIMATE_FIELDS, wire.IDENTITY, wire.STATE)
assert (_CERTAINTY, _PROMISED, _UNDER) == (wire.CERTAINTY, wire.PROMISED, wire.UNDER)
assert (_WHEEL, _WHEELS_SHOWN) == (WHEELS, TWIST_WHEELS)
_X = const(10)  # of a belief
_Y = const(11)
_TURN = const(12)
_SENT = const(20)
assert (_OWN_WEIGHT, _X, _Y, _TURN, _SENT) == (OWN_WEIGHT, X, Y, TURN, SENT)
#: A cell whose sensors miss the parcel for so long steers no more, and then has it no longer.
DOUBT_BEATS = const(20)
LOST_BEATS = const(100)


class Tracking:
    """The belief of one parcel; `identity` is 0 without one, `missing_beats` since it was seen.

    `others` is the mask of the directions of cells whose wheels and sensors serve another parcel.
    """

    def __init__(self, place, footprint, heard, suspicion):
        self._footprint = footprint
        self.agreement = Agreement(place, heard, suspicion)
        self.others = 0
        self.belief = Belief()
        self.sensors = Sensors(self, footprint, heard, suspicion)
        self.drop()

    def drop(self):
        """There is no parcel."""
        self.identity = 0
        self.shaped = False
        self.unplanned = False
        self.under = False
        self.missing_beats = 0
        self._followed_beats = 0
        self.follows = False
        # How certain the pose was that was sent last; -1 if none was.
        self.sent = -1
        self.sensors.turn = 0
        self.belief.drop()
        self.belief.rest()
        self.agreement.reset()

    def adopt(self, identity):
        """Follow this parcel from now on."""
        self.drop()
        self.identity = identity

    def take_shape(self, program):
        """The parcel's outline is known now."""
        self.belief.set(*program.size())
        self.shaped = True
        self.unplanned = program.unplanned
        self.look()

    def place(self, x_um, y_um, turn):
        """The parcel was put there [um; from the cell's own centre]."""
        self.belief.start(x_um, y_um, turn)
        self.belief.rest()
        self.look()

    def look(self):
        """Find whether the cell is under the parcel, or nearly."""
        self.under = self.shaped and self.belief.known and self._footprint.covers(self.belief)

    def miss(self):
        """The parcel is not seen in this beat."""
        self.missing_beats = min(self.missing_beats + 1, LOST_BEATS)

    def may_be_elsewhere(self):
        """Whether the parcel may lie over cells by its edges, none of which has been seen yet.

        Where ways are planned the plan keeps others away from it.
        """
        return self.unplanned and self.belief.is_unseen()

    def is_witnessed(self):
        """Whether two neighbours or more have the parcel where this cell believes it."""
        near = self.agreement.near
        return near & near - 1 != 0

    def follow(self):
        """Take what those under the parcel believe; returns whether there are any."""
        if self.agreement.follow(self.belief):
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
            self.shaped and self.belief.known and self._footprint.reaches(self.belief)
        )

    def is_of_another(self):
        """Whether something else covers a sensor of the cell: one far from the parcel."""
        return self.sensors.show_another()

    @micropython.native
    def is_sure(self):
        """Whether this cell has a belief of its own that nothing is against."""
        return (
            self.sent >= 0
            and self.under
            and not (self.missing_beats or self.agreement.outvoted_beats)
        )

    @micropython.native
    def is_doubtful(self):
        """Whether this cell is not to steer: its own sensors or its neighbours are against it."""
        return self.missing_beats >= DOUBT_BEATS or self.agreement.outvoted_beats >= DOUBT_BEATS

    @micropython.native
    def announce(self, fields, ahead_ms):
        """Write pose and certainty into an estimate, so long after the SYNC of the belief.

        That is no pose where it is too long.
        """
        if self.under and not self.follows and ahead_ms <= _AHEAD_MAX_MS:
            certainty = send(self.belief.registers, 1000 // ahead_ms, fields)
            if self.is_doubtful():
                certainty = 0
            fields[_CERTAINTY] = self.sent = certainty
        else:
            fields[_CERTAINTY] = 0
            self.sent = -1


def updater(tracking, place, footprint, heard, suspicion):
    """What updates a belief; it looks up what changes, and nothing else.

    It brings it to the last SYNC, so many milliseconds after that of the last update.
    """
    check = checker(tracking.sensors, tracking, footprint, heard, suspicion)

    @micropython.native
    def update(  # noqa: PLR0917 - all is at hand
        step_ms,
        sync_ms,
        tracking=tracking,
        agreement=tracking.agreement,
        heard=heard,
        belief=tracking.belief,
        registers=tracking.belief.registers,
        sums=tracking.agreement.registers,
        out=suspicion.out,
        place=place,
        steps=STEPS,
        footprint=footprint.registers,
        estimates=heard.estimates,
        estimate_beat=heard.estimate_beat,
        frames=heard.boxes.frames,
        stamps=heard.boxes.stamps,
        sort=_sort,
        fit=fit,
        near_mask=near_mask,
        roll=roll,
        sum_up=sum_up,
        agree=agree,
        place_outline=place_outline,
        check=check,
    ):
        identity = tracking.identity
        if identity and tracking.shaped:
            masks = sort(estimates, estimate_beat, stamps, heard.beat, identity, out)
            tracking.others = masks >> _OTHERS
            if belief.known:
                # By the belief of before.
                fit(registers, footprint, frames, masks >> _OWN & _CELLS)
            else:
                belief.rest()
            pitch_um = place.pitch_um
            peers = masks & _ALL
            if not (peers or belief.known):
                # Over a border between two buses they may come when the update has begun.
                beat = heard.beat - 1
                peers = sort(estimates, estimate_beat, stamps, beat, identity, out) & _ALL
            agreement.peers = peers
            # A few wheels, all on one side, do not show how a parcel turns.
            under = tracking.under
            follows = tracking.follows = not under or registers[_WHEELS_SHOWN] < _FEW_WHEELS
            agrees = not follows and tracking.sent >= 0
            near = near_mask(estimates, steps, pitch_um, peers, registers, _SENT) if agrees else 0
            agreement.near = near
            outvoted = agrees and agreement.is_outvoted()
            if not (follows or outvoted) or not tracking.follow():
                roll(registers, 2000 // step_ms)
                if agrees and sum_up(
                    estimates, steps, pitch_um, near, registers, out, tracking.sent, sums
                ):
                    agree(registers, sums, _OWN_WEIGHT)
                place_outline(registers, registers[_X], registers[_Y], registers[_TURN])
            if under:
                check(sync_ms)
            else:
                tracking.look()
        if heard.edges:
            tracking.sensors.drop_edges(sync_ms)

    return update


@micropython.viper
def _sort(  # noqa: PLR0917 - viper takes words
    estimates: ptr16,
    estimate_beat: ptr32,
    stamps: ptr32,
    beat: int,
    parcel: int,
    out: ptr8,
) -> int:
    """The mask of the directions whose estimate of this parcel came in this beat.

    From bit 8 on that of the cells whose speeds came in this beat, and count; from bit 17 on that
    of those who are at another parcel.
    """
    masks = 0
    at = 0
    for direction in range(_OWN + 1):
        other = 0
        if direction != _OWN:
            came = estimate_beat[direction]
            state = estimates[at + _STATE]
            if estimates[at + _IDENTITY] != parcel:
                if came != _NEVER and state >= _PROMISED:
                    other = 1
            elif came == beat and state == _UNDER and estimates[at + _CERTAINTY] > 0:
                masks |= 1 << direction
            masks |= other << _OTHERS + direction
            at += _FIELDS
        if stamps[_DIRECTIONS + direction] == beat and not other | out[direction] >> _WHEEL & 1:
            masks |= 1 << _OWN + direction
    return masks
