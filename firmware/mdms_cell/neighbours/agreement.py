"""What the other cells under the same parcel believe, and how far they are to be followed.

A pose that is far off counts for nothing at once, whoever is right. Who is wrong is decided by
number: a neighbour is, if there are as many that agree with this cell as do not; this cell is, if
more agree with one another than with it.
"""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

try:
    import micropython
    from micropython import const
except ImportError:
    from mdms_protocol.cpython import const, micropython, ptr8, ptr16, ptr32

from array import array

from mdms_cell.neighbours.belief import SENT
from mdms_cell.neighbours.geometry.angle import TURN_UM, wrapped
from mdms_cell.neighbours.geometry.place import DIRECTIONS
from mdms_cell.neighbours.suspicion import MISLEADING, POSE, POSE_BEATS
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.words import WIDEN

#: A belief of one's own weighs as much as so many of others.
OWN_WEIGHT = const(1280)
_PEER_WEIGHT = const(16)
#: Poses farther apart than this contradict each other [um, and um at the arm of `angle`].
_FAR_UM = const(25_000)

# What is used in every beat; constants of another module would be looked up.
_DIRECTIONS = const(8)
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
assert (_SENT, _FULL, _YAW_FULL, _STEP_UM) == (SENT, TURN_UM, wire.TURN, wire.STEP_UM)
assert (_FIELDS, _X_AT, _Y_AT) == (wire.ESTIMATE_FIELDS, wire.X, wire.Y)
assert (_YAW_AT, _CERTAINTY_AT) == (wire.YAW, wire.CERTAINTY)
assert (_MISLEADING, _POSE, _DIRECTIONS) == (MISLEADING, POSE, DIRECTIONS)

# Registers of an agreement: five sums over those that agree, as for `belief.agree`, ...
# ... masks of the peers that have sent a pose, and of those near the one that this cell sent ...
_PEERS = const(5)
_NEAR = const(6)
# ... and by direction a row for each: its pose [um; from this cell's centre] and certainty.
_ROWS = const(7)
_X = const(0)
_Y = const(1)
_TURN = const(2)
_CERTAINTY = const(3)
_COLUMNS = const(4)


class Agreement:
    """The poses of the neighbours under the same parcel, as they came in a beat.

    `near` is the mask of those that agree with this cell, and `outvoted_beats` counts how long more
    have agreed with one another.
    """

    def __init__(self, suspicion):
        self._suspicion = suspicion
        self.registers = array("i", [0] * (_ROWS + _COLUMNS * DIRECTIONS))
        self.reset()

    def reset(self):
        """Another parcel, or none."""
        self.outvoted_beats = 0
        self.near = 0

    @micropython.native
    def is_outvoted(self):
        """Whether this cell is outvoted by the poses gathered.

        That is by the pose that it sent at the same SYNC.
        """
        registers = self.registers
        near = self.near = registers[_NEAR]
        if near == registers[_PEERS] and not self._suspicion.cases >> _POSE & 1:
            # As nearly always.
            self.outvoted_beats = 0
            return False
        self._judge(registers[_PEERS], near)
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
        return near_mask(self.registers, self.registers, _ROWS + _COLUMNS * peer)

    def _middle(self):
        """The peer that most others are near to, and how many are, itself included."""
        middle = most = 0
        peers = self.registers[_PEERS]
        for peer in range(DIRECTIONS):
            if peers >> peer & 1 and not self._suspicion.misleads(peer):
                mask = self._near_peer(peer)
                if _count(mask) > most:
                    middle, most = peer, _count(mask)
                    if mask == peers:
                        break
        return middle, most

    def _row(self, peer):
        at = _ROWS + _COLUMNS * peer
        return self.registers[at : at + _COLUMNS]

    def follow(self, belief):
        """Take the mean of those that most are near to; returns whether there are any."""
        middle, total = self._middle()
        if not total:
            return False
        middle_x, middle_y, middle_turn, best = self._row(middle)
        mask = self._near_peer(middle)
        x = y = turn = 0
        for peer in range(DIRECTIONS):
            if mask >> peer & 1:
                its_x, its_y, its_turn, certainty = self._row(peer)
                x += its_x - middle_x
                y += its_y - middle_y
                turn += wrapped(its_turn - middle_turn)
                best = max(best, certainty)
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
def gather(  # noqa: PLR0917 - viper takes words
    estimates: ptr16, steps: ptr8, pitch_um: int, mask: int, peers: ptr32, belief: ptr32
):
    """Write the poses of the neighbours of a mask into an agreement, and who is near this cell.

    They are `place.STEPS` away.
    """
    # As in `program.turn_um`.
    turn_8 = _FULL // 8
    yaw_8 = _YAW_FULL // 8
    at = 0
    to = _ROWS
    for direction in range(_DIRECTIONS):
        if mask >> direction & 1:
            # Fields of 16 bits: viper reads them without their sign.
            x = (estimates[at + _X_AT] & 0xFFFF ^ 0x8000) - 0x8000
            y = (estimates[at + _Y_AT] & 0xFFFF ^ 0x8000) - 0x8000
            yaw = (estimates[at + _YAW_AT] & 0xFFFF ^ 0x8000) - 0x8000
            peers[to + _X] = x * _STEP_UM + (steps[2 * direction] - 1) * pitch_um
            peers[to + _Y] = y * _STEP_UM + (steps[2 * direction + 1] - 1) * pitch_um
            peers[to + _TURN] = yaw * turn_8 // yaw_8
            peers[to + _CERTAINTY] = estimates[at + _CERTAINTY_AT]
        at += _FIELDS
        to += _COLUMNS
    peers[_PEERS] = mask
    peers[_NEAR] = int(near_mask(peers, belief, _SENT))


@micropython.viper
def near_mask(peers: ptr32, pose: ptr32, at: int) -> int:
    """The mask of the peers whose pose is near the one that begins there."""
    widen = int(WIDEN)
    x_um = pose[at + _X] << widen >> widen
    y_um = pose[at + _Y] << widen >> widen
    turn = pose[at + _TURN] << widen >> widen
    mask = peers[_PEERS]
    near = mask
    peer = 0
    at = _ROWS
    while mask >> peer:
        if mask >> peer & 1:
            x = (peers[at + _X] << widen >> widen) - x_um
            y = (peers[at + _Y] << widen >> widen) - y_um
            t = ((peers[at + _TURN] << widen >> widen) - turn + _FULL // 2) % _FULL - _FULL // 2
            is_near = -_FAR_UM < x < _FAR_UM and -_FAR_UM < y < _FAR_UM
            if not (is_near and -_FAR_UM < t < _FAR_UM):
                near &= ~(1 << peer)
        peer += 1
        at += _COLUMNS
    return near


@micropython.viper
def sum_up(peers: ptr32, out: ptr8, belief: ptr32, certainty: int) -> int:
    """Sum up weights, weighted differences from the pose sent [4 um] and variances of those near.

    Those that are suspected, by `Suspicion.out`, are left out; returns the sum of weights.
    """
    widen = int(WIDEN)
    x_um = belief[_SENT + _X] << widen >> widen
    y_um = belief[_SENT + _Y] << widen >> widen
    turn = belief[_SENT + _TURN] << widen >> widen
    mask = peers[_NEAR]
    total = x = y = t = variance = 0
    peer = 0
    at = _ROWS
    while mask >> peer:
        if mask >> peer & 1 and out[peer] & _MISLEADING == 0:
            its = peers[at + _CERTAINTY]
            more = its - certainty
            if more >= 0:
                weight = _PEER_WEIGHT << (more if more < 3 else 3)
            else:
                weight = _PEER_WEIGHT >> (0 - more if more > -4 else 4)
            total += weight
            x += weight * ((peers[at + _X] << widen >> widen) - x_um >> 2)
            y += weight * ((peers[at + _Y] << widen >> widen) - y_um >> 2)
            off = (peers[at + _TURN] << widen >> widen) - turn
            t += weight * ((off + _FULL // 2) % _FULL - _FULL // 2 >> 2)
            variance += weight * (1 << 16 - its)
        peer += 1
        at += _COLUMNS
    peers[0] = total
    peers[1] = x
    peers[2] = y
    peers[3] = t
    peers[4] = variance
    return total
