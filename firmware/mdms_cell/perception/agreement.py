"""What the other cells under the same parcel believe, and how far they are to be followed.

A pose that is far off counts for nothing at once, whoever is right. Who is wrong is decided by
number: a neighbour is, if there are as many that agree with this cell as do not; this cell is, if
more agree with one another than with it.
"""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from array import array

from mdms_cell.perception.angle import TURN_UM, turn_um, wrapped
from mdms_cell.perception.belief import SENT
from mdms_cell.perception.place import DIRECTIONS, STEPS
from mdms_cell.perception.suspicion import CASES, MISLEADING, POSE, POSE_BEATS
from mdms_protocol.compat import WIDEN, const, micropython, ptr8, ptr16, ptr32
from mdms_protocol.neighbours import frames as wire

#: A belief of one's own weighs as much as so many of others.
OWN_WEIGHT = const(1280)
_PEER_WEIGHT = const(16)
#: Poses farther apart than this contradict each other [um, and um at the arm of `angle`].
_FAR_UM = const(25_000)

# What is used in every beat; constants of another module would be looked up.
_SENT = const(20)
_FULL = const(804_248)  # a full turn
_YAW_FULL = const(4096)
_STEP_UM = const(250)
_FIELDS = const(10)  # of an estimate
_X_AT = const(0)
_Y_AT = const(1)
_YAW_AT = const(2)
_CERTAINTY_AT = const(6)
_MISLEADING = const(5)
_POSE = const(2)
_CASES = const(45)
assert (_SENT, _FULL, _YAW_FULL, _STEP_UM) == (SENT, TURN_UM, wire.TURN, wire.STEP_UM)
assert (_FIELDS, _X_AT, _Y_AT) == (wire.ESTIMATE_FIELDS, wire.X, wire.Y)
assert (_YAW_AT, _CERTAINTY_AT) == (wire.YAW, wire.CERTAINTY)
assert (_MISLEADING, _POSE, _CASES) == (MISLEADING, POSE, CASES)

# Registers of an agreement: five sums over those that agree, as for `belief.agree`, ...
# ... and a peer's pose [um; from this cell's centre].
_POSE_AT = const(5)
_REGISTERS = const(8)


class Agreement:
    """The poses of the neighbours under the same parcel, as they came in a beat.

    `peers` is the mask of those that have sent one, `near` of those that agree with this cell, and
    `outvoted_beats` counts how long more have agreed with one another.
    """

    def __init__(self, place, heard, suspicion):
        self._place = place
        self._estimates = heard.estimates
        self._suspicion = suspicion
        self.registers = array("i", [0] * _REGISTERS)
        self.peers = 0
        self.reset()

    def reset(self):
        """Another parcel, or none."""
        self.outvoted_beats = 0
        self.near = 0

    @micropython.native
    def is_outvoted(self):
        """Whether this cell is outvoted by its peers.

        That is by the pose that it sent at the same SYNC.
        """
        near, peers = self.near, self.peers
        if near == peers and not self._suspicion.out[_CASES] >> _POSE & 1:
            # As nearly always.
            self.outvoted_beats = 0
            return False
        self._judge(peers, near)
        return self.outvoted_beats >= POSE_BEATS

    def _judge(self, peers, near):
        """Find who is wrong by number."""
        outvoted = False
        count = _count(near)
        if near != peers:
            middle, most = self._middle()
            outvoted = most > count + 1 and not near >> middle & 1
        self.outvoted_beats = min(self.outvoted_beats + 1, POSE_BEATS) if outvoted else 0
        if near and 2 * count >= _count(peers):
            for peer in range(DIRECTIONS):
                if peers >> peer & 1:
                    self._suspicion.judge(peer, POSE, not near >> peer & 1)

    def _near_peer(self, peer):
        """The mask of the poses that are near that of a peer."""
        registers = self.registers
        for place, number in enumerate(self._pose(peer)):
            registers[_POSE_AT + place] = number
        pitch_um = self._place.pitch_um
        return near_mask(self._estimates, STEPS, pitch_um, self.peers, registers, _POSE_AT)

    def _middle(self):
        """The peer that most others are near to, and how many are, itself included."""
        middle = most = 0
        peers = self.peers
        for peer in range(DIRECTIONS):
            if peers >> peer & 1 and not self._suspicion.misleads(peer):
                mask = self._near_peer(peer)
                if _count(mask) > most:
                    middle, most = peer, _count(mask)
                    if mask == peers:
                        break
        return middle, most

    def _pose(self, peer):
        """Where a peer believes the parcel: x, y and turn [um; from this cell's centre]."""
        at = _FIELDS * peer
        x, y, yaw = self._estimates[at : at + 3]
        shift_x_um, shift_y_um = self._place.shift_um(peer)
        return x * _STEP_UM + shift_x_um, y * _STEP_UM + shift_y_um, turn_um(yaw)

    def follow(self, belief):
        """Take the mean of those that most are near to; returns whether there are any."""
        middle, total = self._middle()
        if not total:
            return False
        middle_x, middle_y, middle_turn = self._pose(middle)
        mask = self._near_peer(middle)
        x = y = turn = best = 0
        for peer in range(DIRECTIONS):
            if mask >> peer & 1:
                its_x, its_y, its_turn = self._pose(peer)
                x += its_x - middle_x
                y += its_y - middle_y
                turn += wrapped(its_turn - middle_turn)
                best = max(best, self._estimates[_FIELDS * peer + _CERTAINTY_AT])
        belief.start(
            middle_x + x // total,
            middle_y + y // total,
            wrapped(middle_turn + turn // total),
            variance=1 << 17 - best,
        )
        return True


def _count(mask):
    count = 0
    while mask:
        mask &= mask - 1
        count += 1
    return count


@micropython.viper
def near_mask(  # noqa: PLR0917 - viper takes words
    estimates: ptr16, steps: ptr8, pitch_um: int, mask: int, pose: ptr32, at: int
) -> int:
    """The mask of those neighbours of a mask whose pose is near the one that begins there.

    They are `place.STEPS` away.
    """
    widen = int(WIDEN)
    x_um = pose[at] << widen >> widen
    y_um = pose[at + 1] << widen >> widen
    turn = pose[at + 2] << widen >> widen
    near = mask
    peer = 0
    at = 0
    while mask >> peer:
        if mask >> peer & 1:
            # Fields of 16 bits: viper reads them without their sign.
            x = (estimates[at + _X_AT] & 0xFFFF ^ 0x8000) - 0x8000
            y = (estimates[at + _Y_AT] & 0xFFFF ^ 0x8000) - 0x8000
            t = (estimates[at + _YAW_AT] & 0xFFFF ^ 0x8000) - 0x8000
            x = x * _STEP_UM + (steps[2 * peer] - 1) * pitch_um - x_um
            y = y * _STEP_UM + (steps[2 * peer + 1] - 1) * pitch_um - y_um
            # As in `angle.turn_um`.
            t = t * (_FULL // 8) // (_YAW_FULL // 8) - turn
            t = (t + _FULL // 2) % _FULL - _FULL // 2
            is_near = -_FAR_UM < x < _FAR_UM and -_FAR_UM < y < _FAR_UM
            if not (is_near and -_FAR_UM < t < _FAR_UM):
                near &= ~(1 << peer)
        peer += 1
        at += _FIELDS
    return near


@micropython.viper
def sum_up(  # noqa: PLR0917 - viper takes words
    estimates: ptr16,
    steps: ptr8,
    pitch_um: int,
    mask: int,
    belief: ptr32,
    out: ptr8,
    certainty: int,
    sums: ptr32,
) -> int:
    """Sum up weights, weighted differences from the pose sent [4 um] and variances of a mask.

    Those that are suspected, by `Suspicion.out`, are left out; returns the sum of weights.
    """
    widen = int(WIDEN)
    x_um = belief[_SENT] << widen >> widen
    y_um = belief[_SENT + 1] << widen >> widen
    turn = belief[_SENT + 2] << widen >> widen
    total = x = y = t = variance = 0
    peer = 0
    at = 0
    while mask >> peer:
        if mask >> peer & 1 and out[peer] & _MISLEADING == 0:
            its = estimates[at + _CERTAINTY_AT]
            more = its - certainty
            if more >= 0:
                weight = _PEER_WEIGHT << (more if more < 3 else 3)
            else:
                weight = _PEER_WEIGHT >> (0 - more if more > -4 else 4)
            # As in `near_mask`.
            its_x = (estimates[at + _X_AT] & 0xFFFF ^ 0x8000) - 0x8000
            its_y = (estimates[at + _Y_AT] & 0xFFFF ^ 0x8000) - 0x8000
            off = (estimates[at + _YAW_AT] & 0xFFFF ^ 0x8000) - 0x8000
            its_x = its_x * _STEP_UM + (steps[2 * peer] - 1) * pitch_um
            its_y = its_y * _STEP_UM + (steps[2 * peer + 1] - 1) * pitch_um
            off = off * (_FULL // 8) // (_YAW_FULL // 8) - turn
            total += weight
            x += weight * (its_x - x_um >> 2)
            y += weight * (its_y - y_um >> 2)
            t += weight * ((off + _FULL // 2) % _FULL - _FULL // 2 >> 2)
            variance += weight * (1 << 16 - its)
        peer += 1
        at += _FIELDS
    sums[0] = total
    sums[1] = x
    sums[2] = y
    sums[3] = t
    sums[4] = variance
    return total
