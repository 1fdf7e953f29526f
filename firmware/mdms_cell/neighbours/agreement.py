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

from mdms_cell.neighbours.geometry.angle import TURN_UM, wrapped
from mdms_cell.neighbours.geometry.place import DIRECTIONS
from mdms_cell.neighbours.suspicion import MISLEADING, POSE, POSE_BEATS
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.words import WIDEN

#: A belief of one's own weighs as much as so many of others.
_OWN_WEIGHT = const(1280)
_PEER_WEIGHT = const(16)
#: Poses farther apart than this contradict each other [um, and um at the arm of `angle`].
_FAR_UM = const(25_000)

# Columns of a peer: its pose [um; from this cell's centre], certainty and direction
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

    def __init__(self, place, heard, suspicion):
        self._place = place
        self._heard = heard
        self._suspicion = suspicion
        self.reset()
        self._poses = array("i", [0] * (_COLUMNS * DIRECTIONS))
        self._sums = array("i", [0] * 5)

    def reset(self):
        """Another parcel, or none."""
        self.outvoted_beats = 0
        self.near = 0
        self._peers = self._near_mask = 0

    def gather(self, mask, sent):
        """Take the poses that these neighbours sent; returns whether this cell is outvoted.

        That is by the pose that it sent at the same SYNC; without one (None) nobody is judged.
        """
        self._peers = _gather(self._heard.estimates, self._place.shifts, mask, self._poses)
        if sent is None:
            self.near = self._near_mask = 0
            return False
        self._judge(sent)
        return self.outvoted_beats >= POSE_BEATS

    def _near_peer(self, peer):
        """The mask of the poses that are near that of a peer."""
        return _near(self._poses, self._peers, self._poses, _COLUMNS * peer)

    def _pose(self, peer):
        poses, at = self._poses, _COLUMNS * peer
        return poses[at + _X], poses[at + _Y], poses[at + _TURN]

    def _middle(self):
        """The number of the peer that most others are near to, and how many, itself included."""
        middle = most = 0
        for peer in range(self._peers):
            if not self._suspicion.misleads(self._poses[_COLUMNS * peer + _DIRECTION]):
                near = _count(self._near_peer(peer))
                if near > most:
                    middle, most = peer, near
                    if near == self._peers:
                        break
        return middle, most

    @micropython.native
    def _judge(self, sent):
        """Find who is wrong by number."""
        mask = self._near_mask = _near(self._poses, self._peers, sent, 0)
        suspicion = self._suspicion
        near = self._peers
        if mask + 1 == 1 << near:
            self.near = near
            # As nearly always.
            self.outvoted_beats = 0
            if suspicion.is_quiet(POSE):
                return
        else:
            self.near = near = _count(mask)
            middle, most = self._middle()
            outvoted = most > near + 1 and not mask >> middle & 1
            self.outvoted_beats = min(self.outvoted_beats + 1, POSE_BEATS) if outvoted else 0
        if near and 2 * near >= self._peers:
            for peer in range(self._peers):
                far = not mask >> peer & 1
                suspicion.judge(self._poses[_COLUMNS * peer + _DIRECTION], POSE, far)

    def agree(self, belief, sent, certainty):
        """Move the belief towards those near what this cell sent at the same SYNC.

        Its outline is left to be placed.
        """
        sums = self._sums
        _sum_up(self._poses, self._near_mask, self._suspicion.out, sent, certainty, sums)
        if sums[0]:
            belief.agree(sums, _OWN_WEIGHT)

    def follow(self, belief):
        """Take the mean of those that most are near to; returns whether there are any."""
        middle, total = self._middle()
        if not total:
            return False
        middle_x, middle_y, middle_turn = self._pose(middle)
        mask = self._near_peer(middle)
        x = y = turn = best = total = 0
        for peer in range(self._peers):
            if mask >> peer & 1:
                its_x, its_y, its_turn = self._pose(peer)
                total += 1
                x += its_x - middle_x
                y += its_y - middle_y
                turn += wrapped(its_turn - middle_turn)
                best = max(best, self._poses[_COLUMNS * peer + _CERTAINTY])
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
def _gather(estimates: ptr32, shifts: ptr32, mask: int, poses: ptr32) -> int:
    """Write the poses of the neighbours of a mask; returns how many."""
    widen = int(WIDEN)
    fields = int(wire.ESTIMATE_FIELDS)
    x_at = int(wire.X)
    y_at = int(wire.Y)
    yaw_at = int(wire.YAW)
    certainty_at = int(wire.CERTAINTY)
    step_um = int(wire.STEP_UM)
    # As in `program.turn_um`.
    turn_8 = int(TURN_UM) // 8
    yaw_8 = int(wire.TURN) // 8
    peers = 0
    direction = 0
    while mask >> direction:
        if mask >> direction & 1:
            at = fields * direction
            to = _COLUMNS * peers
            shift = shifts[2 * direction] << widen >> widen
            poses[to + _X] = (estimates[at + x_at] << widen >> widen) * step_um + shift
            shift = shifts[2 * direction + 1] << widen >> widen
            poses[to + _Y] = (estimates[at + y_at] << widen >> widen) * step_um + shift
            yaw = estimates[at + yaw_at] << widen >> widen
            poses[to + _TURN] = yaw * turn_8 // yaw_8
            poses[to + _CERTAINTY] = estimates[at + certainty_at]
            poses[to + _DIRECTION] = direction
            peers += 1
        direction += 1
    return peers


@micropython.viper
def _near(poses: ptr32, peers: int, pose: ptr32, at: int) -> int:
    """The mask of the peers whose pose is near the one that begins there."""
    widen = int(WIDEN)
    full = int(TURN_UM)
    x_um = pose[at + _X] << widen >> widen
    y_um = pose[at + _Y] << widen >> widen
    turn = pose[at + _TURN] << widen >> widen
    mask = 0
    for peer in range(peers):
        at = _COLUMNS * peer
        x = (poses[at + _X] << widen >> widen) - x_um
        y = (poses[at + _Y] << widen >> widen) - y_um
        t = ((poses[at + _TURN] << widen >> widen) - turn + full // 2) % full - full // 2
        near = -_FAR_UM < x < _FAR_UM and -_FAR_UM < y < _FAR_UM
        if near and -_FAR_UM < t < _FAR_UM:
            mask |= 1 << peer
    return mask


@micropython.viper
def _sum_up(  # noqa: PLR0917 - viper takes words
    poses: ptr32,
    mask: int,
    out: ptr8,
    pose: ptr32,
    certainty: int,
    sums: ptr32,
):
    """Sum up weights, weighted differences from a pose [4 um] and variances of the peers of a mask.

    Those that are suspected, by `Suspicion.out`, are left out.
    """
    widen = int(WIDEN)
    full = int(TURN_UM)
    x_um = pose[_X] << widen >> widen
    y_um = pose[_Y] << widen >> widen
    turn = pose[_TURN] << widen >> widen
    misleading = int(MISLEADING)
    total = x = y = t = variance = 0
    peer = 0
    while mask >> peer:
        at = _COLUMNS * peer
        if mask >> peer & 1 and out[poses[at + _DIRECTION]] & misleading == 0:
            its = poses[at + _CERTAINTY]
            more = its - certainty
            if more >= 0:
                weight = _PEER_WEIGHT << (more if more < 3 else 3)
            else:
                weight = _PEER_WEIGHT >> (0 - more if more > -4 else 4)
            total += weight
            x += weight * ((poses[at + _X] << widen >> widen) - x_um >> 2)
            y += weight * ((poses[at + _Y] << widen >> widen) - y_um >> 2)
            off = (poses[at + _TURN] << widen >> widen) - turn
            t += weight * ((off + full // 2) % full - full // 2 >> 2)
            variance += weight * (1 << 16 - its)
        peer += 1
    sums[0] = total
    sums[1] = x
    sums[2] = y
    sums[3] = t
    sums[4] = variance
