"""Tracking: place and motion of the parcel, by all that a cell and its neighbours have seen.

A cell under the parcel keeps a belief of its own. It rolls the belief on by the wheels of its
neighbourhood. It corrects the belief where sensors see an edge, and agrees with the neighbours
under the same parcel. A cell beside the parcel follows the cells under it.
"""
# Viper takes any buffer, and the stubs bytes alone.
# pyright: reportArgumentType=false

from mdms_cell.perception.angle import turn_um, wrapped
from mdms_cell.perception.belief import Belief
from mdms_cell.perception.footprint import MARGIN
from mdms_cell.perception.place import AXES, DIRECTIONS, OWN
from mdms_cell.perception.sensors import Sensors
from mdms_cell.perception.suspicion import POSE, POSE_BEATS, SILENCE, WHEELS
from mdms_cell.perception.twist import SLIPS, against, fit
from mdms_cell.perception.twist import WHEELS as WHEELS_SHOWN
from mdms_protocol.compat import const, micropython
from mdms_protocol.neighbours import frames as wire

#: Fewer wheels, all on one side, do not show how a parcel turns, nor that one of them is wrong.
_FEW_WHEELS = const(5)
#: A cell whose sensors miss the parcel for so long steers no more, and then has it no longer.
DOUBT_BEATS = const(20)
LOST_BEATS = const(100)
#: A cell that has been alone with its belief for so long steers no more.
ALONE_BEATS = const(20)
#: A belief of one's own weighs as much as so many of others.
_OWN_WEIGHT = const(1280)
_PEER_WEIGHT = const(16)


class Agreement:
    """The poses of the neighbours under the same parcel, as they came in a beat.

    A pose that is far off counts for nothing at once, in either cell. Number decides which one is
    wrong. A neighbour is wrong if as many cells agree with this cell as do not. This cell is wrong
    if more cells agree with one another than with it. Cells that agree move towards their weighted
    mean, which is one step of average consensus (Olfati-Saber and Murray 2004).

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
            belief.agree((x, y, turn), variance, weights, _OWN_WEIGHT)

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


class Tracking:
    """The belief of one parcel; `identity` is 0 without one, `missing_beats` since it was seen.

    `jump_beats` grows by `DOUBT_BEATS` when the belief jumps, and falls by one in each other beat.
    `alone_beats` counts those in which no neighbour has confirmed the belief of a cell that drives.
    `others` is the mask of the directions of cells whose wheels and sensors serve another parcel.
    `under` is whether the cell is under the parcel, or nearly; `follows` whether it makes its pose
    of what neighbours believe. `sent` is how certain the pose was that was sent last, -1 if none.
    """

    def __init__(self, place, footprint, heard, suspicion):
        self._footprint = footprint
        self._heard = heard
        self._suspicion = suspicion
        self.agreement = Agreement(place, heard, suspicion)
        self.belief = Belief()
        self.sensors = Sensors(self, footprint, heard, suspicion)
        self.drop()

    def drop(self):
        """There is no parcel."""
        self.identity = self.others = 0
        self.shaped = self.under = self.follows = False
        self.missing_beats = self.jump_beats = self.alone_beats = self._followed_beats = 0
        self.sent = -1
        self.sensors.reset()
        self.belief.reset()
        self.agreement.reset()

    def adopt(self, identity):
        """Follow this parcel from now on."""
        self.drop()
        self.identity = identity

    def take_shape(self, program):
        """The parcel's outline is known now."""
        self.belief.set(*program.size())
        self.shaped = True
        self.look()

    def place(self, x_um, y_um, turn):
        """The parcel was put there [um; from the cell's own centre]."""
        self.belief.start(x_um, y_um, turn)
        self.belief.twist.reset()
        self.look()

    def look(self):
        """Find whether the parcel covers a wheel or a sensor of the cell, or nearly."""
        belief = self.belief
        self.under = belief.known and self._footprint.within(belief, OWN, MARGIN) != 0

    def miss(self):
        """The parcel is not seen in this beat."""
        self.missing_beats = min(self.missing_beats + 1, LOST_BEATS)

    def is_witnessed(self):
        """Whether two neighbours or more have the parcel where this cell believes it."""
        near = self.agreement.near
        return near & near - 1 != 0

    def follow(self):
        """Take what those under the parcel believe; returns whether there are any.

        A cell beside the parcel gives up five beats after the last of them.
        """
        if self.agreement.follow(self.belief):
            self._followed_beats = 0
            return True
        if not self.under:
            self._followed_beats += 1
            if self._followed_beats > 5:
                self.belief.drop()
        return False

    def is_over(self):
        """Whether the parcel lies over the cell's square; not only over its wheels and sensors."""
        return self.under or (self.belief.known and self._footprint.reaches(self.belief))

    @micropython.native
    def is_sure(self):
        """Whether this cell has a belief of its own that nothing is against."""
        return (
            self.sent >= 0
            and self.under
            and not (self.missing_beats or self.agreement.outvoted_beats)
            and self.jump_beats <= DOUBT_BEATS
        )

    @micropython.native
    def is_doubtful(self):
        """Whether this cell is not to steer.

        Its own sensors or its neighbours are against it, or its belief jumps again and again. A
        sensor that is stuck over no parcel draws beliefs to places that agree with it, by jumps.
        """
        return (
            self.missing_beats >= DOUBT_BEATS
            or self.agreement.outvoted_beats >= DOUBT_BEATS
            or self.jump_beats > DOUBT_BEATS
        )

    def find_witness(self, drives):
        """Count the beats in which no neighbour has had the parcel where this cell has it.

        Only those count in which the cell `drives` for the parcel over it, or might, by a belief of
        its own.
        """
        if not drives or self.follows or self.agreement.near:
            self.alone_beats = 0
        elif self.alone_beats < ALONE_BEATS:
            self.alone_beats += 1

    def is_alone(self):
        """Return whether this cell is not to steer, because no neighbour confirms its belief.

        It sends its pose as before: two neighbours that are alone would not find together else.
        """
        return self.alone_beats >= ALONE_BEATS

    @micropython.native
    def announce(self, fields, ahead_ms):
        """Write pose and certainty into an estimate, so long after the SYNC of the belief.

        That is no pose where it is longer than 50 ms.
        """
        if self.under and not self.follows and ahead_ms <= 50:
            certainty = self.belief.send(fields, ahead_ms)
            if self.is_doubtful():
                certainty = 0
            fields[wire.CERTAINTY] = self.sent = certainty
        else:
            fields[wire.CERTAINTY] = 0
            self.sent = -1

    # The beat

    @micropython.native
    def update(self, step_ms, sync_ms):
        """Bring the belief to the last SYNC, so many milliseconds after that of the last update.

        It is rolled on by the wheels, moved towards those of neighbours, and corrected by sensors.
        """
        if self.identity and self.shaped:
            belief, heard, identity = self.belief, self._heard, self.identity
            # One whose promise to another has not run out yet has a pose before it is under it.
            at_any = heard.having(wire.STATE, wire.PROMISED, wire.UNDER)
            at_any |= heard.having(wire.CERTAINTY, 1, 15)
            self.others = at_any & ~heard.having(wire.IDENTITY, identity)
            if belief.known:
                # By the belief of before.
                self._fit_twist()
            else:
                belief.twist.reset()
            outvoted = self._compare_poses()
            known = belief.known
            belief.roll(step_ms)
            x_um, y_um = belief.pose[0], belief.pose[1]
            if not (self.follows or outvoted) or not self.follow():
                if self._agrees():
                    self.agreement.move(belief, self.sent)
                belief.move_outline()
            if self.under:
                self.sensors.check(sync_ms)
            else:
                self.look()
            self._find_jump(known, x_um, y_um)
        if self._heard.edges:
            self.sensors.drop_edges(sync_ms)

    @micropython.native
    def _find_jump(self, known, x_um, y_um):
        """Find whether the belief has jumped by 8 mm from where wheels have rolled it, if known."""
        pose = self.belief.pose
        if known and max(abs(pose[0] - x_um), abs(pose[1] - y_um)) > 8_000:
            self.jump_beats = min(self.jump_beats + DOUBT_BEATS, 2 * DOUBT_BEATS)
        elif self.jump_beats:
            self.jump_beats -= 1

    @micropython.native
    def _fit_twist(self):
        """Find how the parcel moves, by the wheels under it whose speeds came in this beat."""
        heard, belief, footprint = self._heard, self.belief, self._footprint
        stamps, out = heard.boxes.stamps, self._suspicion.out
        cells = wheels = 0
        for cell in range(DIRECTIONS + 1):
            came = stamps[DIRECTIONS + cell] == heard.beat
            if came and not (self.others >> cell & 1 or out[cell] >> WHEELS & 1):
                cells |= 1 << cell
                wheels |= footprint.within(belief, cell, 0, AXES) << 2 * cell
        footprint.find_levers(belief, cells)
        twist, along, levers = belief.twist, footprint.along, footprint.levers
        fit(twist.speeds, twist.before, twist.shown, along, levers, heard.boxes.frames, wheels)

    @micropython.native
    def _compare_poses(self):
        """Compare what cells under the parcel believe; returns whether this cell is outvoted."""
        belief = self.belief
        peers = self._peers(self._heard.beat)
        if not (peers or belief.known):
            # Over a border between two buses they may come when the update has begun.
            peers = self._peers(self._heard.beat - 1)
        self.follows = not self.under or belief.twist.shown[WHEELS_SHOWN] < _FEW_WHEELS
        return self.agreement.compare(peers, belief.sent if self._agrees() else None)

    @micropython.native
    def _agrees(self):
        """Whether this cell has sent a pose of its own, which others may be compared with."""
        return not self.follows and self.sent >= 0

    @micropython.native
    def _peers(self, beat):
        """The mask of the directions whose pose of this parcel came in this beat."""
        came, peers = self._heard.estimate_beat, self._heard.posed(self.identity)
        for direction in range(DIRECTIONS):
            if came[direction] != beat:
                peers &= ~(1 << direction)
        return peers

    @micropython.native
    def judge(self, asked):
        """Compare the reports of a cell under the parcel with the belief of this one.

        One cell is compared in a beat. `asked` is the mask of the cells asked for the parcel.
        """
        suspicion, heard = self._suspicion, self._heard
        cell = suspicion.turn = suspicion.turn + 1 if suspicion.turn < OWN else 0
        if not self.is_sure():
            return
        if cell != OWN:
            if not self._footprint.present >> cell & 1:
                return
            silent = heard.age(cell) > 3  # or else a frame was lost
            if asked >> cell & 1 if silent else suspicion.has_case(SILENCE):
                suspicion.judge(cell, SILENCE, silent)
            if heard.boxes.stamps[DIRECTIONS + cell] != heard.beat or self.others >> cell & 1:
                return
        if self.belief.twist.shown[WHEELS_SHOWN] >= _FEW_WHEELS:
            self._judge_wheels(cell)

    @micropython.native
    def _judge_wheels(self, cell):
        """A wheel deep under the parcel is wrong if it does not turn with it."""
        footprint, belief = self._footprint, self.belief
        axes = footprint.within(belief, cell, -MARGIN, AXES)
        footprint.find_levers(belief, 1 << cell)
        shown = against(belief.twist.speeds, footprint, self._heard.boxes.frames, cell, axes)
        if shown & SLIPS or (shown and self._suspicion.has_case(WHEELS)):
            self._suspicion.judge(cell, WHEELS, shown & SLIPS != 0)


def _weight(more):
    """The weight of a peer whose pose is so much more certain than this cell's."""
    return _PEER_WEIGHT << min(more, 3) if more >= 0 else _PEER_WEIGHT >> min(-more, 4)


def _count(mask):
    count = 0
    while mask:
        mask &= mask - 1
        count += 1
    return count
