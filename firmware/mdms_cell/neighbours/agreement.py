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
    from mdms_protocol.cpython import const, micropython, ptr8, ptr32

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
assert (_MISLEADING, _POSE) == (MISLEADING, POSE)

# Registers of an agreement: five sums over those that agree, as for `belief.agree`, ...
# ... how many peers have sent a pose, the mask of those near the one that this cell sent ...
_PEERS = const(5)
_NEAR_MASK = const(6)
# ... and a row for each: its pose [um; from this cell's centre], certainty and direction.
_ROWS = const(7)
_X = const(0)
_Y = const(1)
_TURN = const(2)
_CERTAINTY = const(3)
_DIRECTION = const(4)
_COLUMNS = const(5)


class Agreement:
    """The poses of the neighbours under the same parcel, as they came in a beat.

    `near` of them agree with this cell, and `outvoted_beats` counts how long more have agreed with
    one another.
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
        near = registers[_PEERS]
        if registers[_NEAR_MASK] + 1 == 1 << near and not self._suspicion.cases >> _POSE & 1:
            # As nearly always.
            self.near = near
            self.outvoted_beats = 0
            return False
        self._judge()
        return self.outvoted_beats >= POSE_BEATS

    def _judge(self):
        """Find who is wrong by number."""
        suspicion = self._suspicion
        registers = self.registers
        peers, mask = registers[_PEERS], registers[_NEAR_MASK]
        self.near = near = _count(mask)
        outvoted = False
        if near < peers:
            middle, most = self._middle()
            outvoted = most > near + 1 and not mask >> middle & 1
        self.outvoted_beats = min(self.outvoted_beats + 1, POSE_BEATS) if outvoted else 0
        if near and 2 * near >= peers:
            for peer in range(peers):
                far = not mask >> peer & 1
                suspicion.judge(self._of(peer, _DIRECTION), POSE, far)

    def _of(self, peer, column):
        return self.registers[_ROWS + _COLUMNS * peer + column]

    def _near_peer(self, peer):
        """The mask of the poses that are near that of a peer."""
        return near_mask(self.registers, self.registers, _ROWS + _COLUMNS * peer)

    def _middle(self):
        """The number of the peer that most others are near to, and how many, itself included."""
        middle = most = 0
        peers = self.registers[_PEERS]
        for peer in range(peers):
            if not self._suspicion.misleads(self._of(peer, _DIRECTION)):
                near = _count(self._near_peer(peer))
                if near > most:
                    middle, most = peer, near
                    if near == peers:
                        break
        return middle, most

    def follow(self, belief):
        """Take the mean of those that most are near to; returns whether there are any."""
        middle, total = self._middle()
        if not total:
            return False
        middle_x, middle_y = self._of(middle, _X), self._of(middle, _Y)
        middle_turn = self._of(middle, _TURN)
        mask = self._near_peer(middle)
        x = y = turn = best = total = 0
        for peer in range(self.registers[_PEERS]):
            if mask >> peer & 1:
                total += 1
                x += self._of(peer, _X) - middle_x
                y += self._of(peer, _Y) - middle_y
                turn += wrapped(self._of(peer, _TURN) - middle_turn)
                best = max(best, self._of(peer, _CERTAINTY))
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
def gather(estimates: ptr32, shifts: ptr32, mask: int, peers: ptr32, belief: ptr32):
    """Write the poses of the neighbours of a mask into an agreement, and who is near this cell."""
    widen = int(WIDEN)
    # As in `program.turn_um`.
    turn_8 = _FULL // 8
    yaw_8 = _YAW_FULL // 8
    count = 0
    to = _ROWS
    direction = 0
    while mask >> direction:
        if mask >> direction & 1:
            at = _FIELDS * direction
            shift = shifts[2 * direction] << widen >> widen
            peers[to + _X] = (estimates[at + _X_AT] << widen >> widen) * _STEP_UM + shift
            shift = shifts[2 * direction + 1] << widen >> widen
            peers[to + _Y] = (estimates[at + _Y_AT] << widen >> widen) * _STEP_UM + shift
            yaw = estimates[at + _YAW_AT] << widen >> widen
            peers[to + _TURN] = yaw * turn_8 // yaw_8
            peers[to + _CERTAINTY] = estimates[at + _CERTAINTY_AT]
            peers[to + _DIRECTION] = direction
            count += 1
            to += _COLUMNS
        direction += 1
    peers[_PEERS] = count
    peers[_NEAR_MASK] = int(near_mask(peers, belief, _SENT))


@micropython.viper
def near_mask(peers: ptr32, pose: ptr32, at: int) -> int:
    """The mask of the peers whose pose is near the one that begins there."""
    widen = int(WIDEN)
    x_um = pose[at + _X] << widen >> widen
    y_um = pose[at + _Y] << widen >> widen
    turn = pose[at + _TURN] << widen >> widen
    mask = 0
    at = _ROWS
    for peer in range(peers[_PEERS]):
        x = (peers[at + _X] << widen >> widen) - x_um
        y = (peers[at + _Y] << widen >> widen) - y_um
        t = ((peers[at + _TURN] << widen >> widen) - turn + _FULL // 2) % _FULL - _FULL // 2
        near = -_FAR_UM < x < _FAR_UM and -_FAR_UM < y < _FAR_UM
        if near and -_FAR_UM < t < _FAR_UM:
            mask |= 1 << peer
        at += _COLUMNS
    return mask


@micropython.viper
def sum_up(peers: ptr32, out: ptr8, belief: ptr32, certainty: int) -> int:
    """Sum up weights, weighted differences from the pose sent [4 um] and variances of those near.

    Those that are suspected, by `Suspicion.out`, are left out; returns the sum of weights.
    """
    widen = int(WIDEN)
    x_um = belief[_SENT + _X] << widen >> widen
    y_um = belief[_SENT + _Y] << widen >> widen
    turn = belief[_SENT + _TURN] << widen >> widen
    mask = peers[_NEAR_MASK]
    total = x = y = t = variance = 0
    at = _ROWS
    while mask:
        if mask & 1 and out[peers[at + _DIRECTION]] & _MISLEADING == 0:
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
        mask >>= 1
        at += _COLUMNS
    peers[0] = total
    peers[1] = x
    peers[2] = y
    peers[3] = t
    peers[4] = variance
    return total
