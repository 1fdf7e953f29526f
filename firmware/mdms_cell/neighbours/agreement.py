"""What the other cells under the same parcel believe, and how far they are to be followed.

A pose that is far off counts for nothing at once, whoever is right. Who is wrong is decided by
number: a neighbour is, if there are as many that agree with this cell as do not; this cell is, if
more agree with one another than with it.
"""

from array import array

from mdms_cell.neighbours.angle import wrapped
from mdms_cell.neighbours.place import DIRECTIONS
from mdms_cell.neighbours.program import turn_um
from mdms_cell.neighbours.suspicion import POSE, POSE_BEATS
from mdms_protocol.neighbours import frames as wire

#: A belief of one's own weighs as much as so many of others.
_OWN_WEIGHT = 1280
_PEER_WEIGHT = 16
#: Poses farther apart than this contradict each other [um, and um at the arm of `angle`].
FAR_UM = 25_000


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
        self._direction = bytearray(DIRECTIONS)
        self._x = array("i", [0] * DIRECTIONS)
        self._y = array("i", [0] * DIRECTIONS)
        self._turn = array("i", [0] * DIRECTIONS)

    def reset(self):
        """Another parcel, or none."""
        self.outvoted_beats = 0
        self.near = 0
        self._peers = 0

    def gather(self, mask):
        """Take the poses that these neighbours sent [um; from this cell's centre]."""
        heard, shifts = self._heard, self._place.shifts
        self.near = 0
        peers = 0
        for direction in range(DIRECTIONS):
            if mask >> direction & 1:
                x_um = heard.field(direction, wire.X) * wire.STEP_UM
                y_um = heard.field(direction, wire.Y) * wire.STEP_UM
                self._direction[peers] = direction
                self._x[peers] = x_um + shifts[2 * direction]
                self._y[peers] = y_um + shifts[2 * direction + 1]
                self._turn[peers] = turn_um(heard.field(direction, wire.YAW))
                peers += 1
        self._peers = peers

    def _is_near(self, peer, x_um, y_um, turn):
        return (
            abs(self._x[peer] - x_um) < FAR_UM
            and abs(self._y[peer] - y_um) < FAR_UM
            and abs(wrapped(self._turn[peer] - turn)) < FAR_UM
        )

    def _near(self, x_um, y_um, turn):
        """How many of the poses are near this one."""
        near = 0
        for peer in range(self._peers):
            near += self._is_near(peer, x_um, y_um, turn)
        return near

    def _middle(self):
        """The number of the peer that most others are near to, and how many, itself included."""
        middle = most = 0
        for peer in range(self._peers):
            if not self._suspicion.misleads(self._direction[peer]):
                near = self._near(self._x[peer], self._y[peer], self._turn[peer])
                if near > most:
                    middle, most = peer, near
                    if near == self._peers:
                        break
        return middle, most

    def judge(self, sent):
        """Find who is wrong by number, by the pose that this cell sent at the same SYNC."""
        self.near = near = self._near(*sent)
        if near == self._peers:
            # As nearly always.
            self.outvoted_beats = 0
        else:
            middle, most = self._middle()
            outvoted = most > near + 1 and not self._is_near(middle, *sent)
            self.outvoted_beats = min(self.outvoted_beats + 1, POSE_BEATS) if outvoted else 0
        if near and 2 * near >= self._peers:
            for peer in range(self._peers):
                far = not self._is_near(peer, *sent)
                self._suspicion.judge(self._direction[peer], POSE, far)

    def agree(self, belief, sent, certainty):
        """Move the belief towards those near what this cell sent at the same SYNC."""
        own_x, own_y, own_turn = sent
        total = x = y = turn = variance = 0
        for peer in range(self._peers):
            direction = self._direction[peer]
            if self._suspicion.misleads(direction) or not self._is_near(peer, *sent):
                continue
            its = self._heard.field(direction, wire.CERTAINTY)
            weight = _weight(its - certainty)
            total += weight
            x += weight * (self._x[peer] - own_x >> 2)
            y += weight * (self._y[peer] - own_y >> 2)
            turn += weight * (wrapped(self._turn[peer] - own_turn) >> 2)
            variance += weight * (1 << 16 - its)
        if total:
            mean = variance // total
            x, y, turn = x * 4 // total, y * 4 // total, turn * 4 // total
            belief.agree(total, total + _OWN_WEIGHT, (x, y, turn), mean)

    def follow(self, belief):
        """Take the mean of those that most are near to; returns whether there are any."""
        middle, total = self._middle()
        if not total:
            return False
        middle_x, middle_y, middle_turn = self._x[middle], self._y[middle], self._turn[middle]
        x = y = turn = best = total = 0
        for peer in range(self._peers):
            if self._is_near(peer, middle_x, middle_y, middle_turn):
                total += 1
                x += self._x[peer] - middle_x
                y += self._y[peer] - middle_y
                turn += wrapped(self._turn[peer] - middle_turn)
                best = max(best, self._heard.field(self._direction[peer], wire.CERTAINTY))
        belief.start(
            middle_x + x // total,
            middle_y + y // total,
            wrapped(middle_turn + turn // total),
            variance=1 << 17 - best,
        )
        return True


def _weight(more):
    """Of a belief that is so many steps more certain."""
    return _PEER_WEIGHT << min(more, 3) if more >= 0 else _PEER_WEIGHT >> min(-more, 4)
