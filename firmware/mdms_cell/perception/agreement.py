"""Beliefs of the other cells under the same parcel, and how far to follow them.

A pose that is far off counts for nothing at once, in either cell. Number decides which one is
wrong. A neighbour is wrong if as many cells agree with this cell as do not. This cell is wrong if
more cells agree with one another than with it. Cells that agree move towards their weighted mean,
which is one step of average consensus (Olfati-Saber and Murray 2004).
"""

from mdms_cell.perception.angle import turn_um, wrapped
from mdms_cell.perception.place import DIRECTIONS
from mdms_cell.perception.suspicion import POSE, POSE_BEATS
from mdms_protocol.compat import const, micropython
from mdms_protocol.neighbours import frames as wire

#: A belief of one's own weighs as much as so many of others.
OWN_WEIGHT = const(1280)
_PEER_WEIGHT = const(16)


class Agreement:
    """The poses of the neighbours under the same parcel, as they came in a beat.

    `peers` is the mask of those that have sent one. `near` is the mask of those that agree with
    this cell. `outvoted_beats` counts how long more have agreed with one another.
    """

    def __init__(self, place, heard, suspicion):
        self._place = place
        self._estimates = heard.estimates
        self._suspicion = suspicion
        self.reset()

    def reset(self):
        """Another parcel, or none."""
        self.outvoted_beats = 0
        self.peers = self.near = 0

    @micropython.native
    def compare(self, peers, sent):
        """Find those of the peers in a mask that agree with the pose that this cell has sent.

        That is of the same SYNC; None counts none. Returns whether this cell is outvoted.
        """
        self.peers = peers
        if sent is None:
            self.near = 0
            return False
        near = self.near = self._near(sent)
        if near == peers and not self._suspicion.has_case(POSE):
            # As nearly always.
            self.outvoted_beats = 0
            return False
        self._judge(peers, near)
        return self.outvoted_beats >= POSE_BEATS

    def _judge(self, peers, near):
        """Find the wrong cells by number."""
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

    def _middle(self):
        """The peer that most others are near to, and how many are, itself included."""
        middle = most = 0
        for peer in range(DIRECTIONS):
            if self.peers >> peer & 1 and not self._suspicion.misleads(peer):
                mask = self._near(self.pose_of(peer))
                if _count(mask) > most:
                    middle, most = peer, _count(mask)
                    if mask == self.peers:
                        break
        return middle, most

    @micropython.native
    def pose_of(self, peer):
        """Where a peer believes the parcel: x, y and turn [um; from this cell's centre]."""
        estimates, at = self._estimates, wire.ESTIMATE_FIELDS * peer
        x_um, y_um = self._place.shift_um(peer)
        x_um += estimates[at + wire.X] * wire.STEP_UM
        y_um += estimates[at + wire.Y] * wire.STEP_UM
        return x_um, y_um, turn_um(estimates[at + wire.YAW])

    @micropython.native
    def _near(self, pose):
        """The mask of the peers whose pose is within 25 mm of this one, at the arm too."""
        mask = 0
        for peer in range(DIRECTIONS):
            if self.peers >> peer & 1:
                x_um, y_um, turn = self.pose_of(peer)
                off_um = max(abs(x_um - pose[0]), abs(y_um - pose[1]))
                if max(off_um, abs(wrapped(turn - pose[2]))) < 25_000:
                    mask |= 1 << peer
        return mask

    @micropython.native
    def move(self, belief, certainty):
        """Move a belief towards those that agree, with the certainty of the estimate sent.

        Each neighbour weighs the more, the more certain it is. Suspects weigh nothing. The outline
        is left to be placed.
        """
        sent = belief.sent
        weights = x = y = turn = variance = 0
        for peer in range(DIRECTIONS):
            if self.near >> peer & 1 and not self._suspicion.misleads(peer):
                its = self.pose_of(peer)
                its_certainty = self._estimates[wire.ESTIMATE_FIELDS * peer + wire.CERTAINTY]
                weight = _weight(its_certainty - certainty)
                weights += weight
                x += weight * (its[0] - sent[0] >> 2)
                y += weight * (its[1] - sent[1] >> 2)
                turn += weight * (wrapped(its[2] - sent[2]) >> 2)
                variance += weight * (1 << 16 - its_certainty)
        if weights:
            belief.agree((x, y, turn), variance, weights, OWN_WEIGHT)

    def follow(self, belief):
        """Take the mean of those that most are near to; returns whether there are any."""
        peer, total = self._middle()
        if not total:
            return False
        middle = self.pose_of(peer)
        mask = self._near(middle)
        x = y = turn = best = 0
        for peer in range(DIRECTIONS):
            if mask >> peer & 1:
                its = self.pose_of(peer)
                x += its[0] - middle[0]
                y += its[1] - middle[1]
                turn += wrapped(its[2] - middle[2])
                best = max(best, self._estimates[wire.ESTIMATE_FIELDS * peer + wire.CERTAINTY])
        x_um, y_um = middle[0] + x // total, middle[1] + y // total
        belief.start(x_um, y_um, wrapped(middle[2] + turn // total), variance=1 << 17 - best)
        return True


def _weight(more):
    """The weight of a peer whose pose is so much more certain than this cell's."""
    return _PEER_WEIGHT << min(more, 3) if more >= 0 else _PEER_WEIGHT >> min(-more, 4)


def _count(mask):
    count = 0
    while mask:
        mask &= mask - 1
        count += 1
    return count
