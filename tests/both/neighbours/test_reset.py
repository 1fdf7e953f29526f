"""A cell that has been stopped and started behaves like a newly set up cell.

The one has lived through a while of random events, the other has not. From then on both get the
same frames, and are to send the same. The clock and the number of the beat go on.
"""

from array import array

from layer_bench import BEAT_MS, IDENTITY, NEIGHBOURS, NODE, Middle, some_of

from mdms_cell.drive import speed_loop
from mdms_cell.perception.heard import SEEN
from mdms_protocol.codecs import cob
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours.precedence import pack_precedence

PRE_OPERATIONAL = 128
OTHER = 3
#: After so long without SYNC any program may have been missed.
PAUSE_BEATS = 12
#: Enough to be promised again after a restart, and to drive.
FOLLOWING_BEATS = 130
SEEDS = (2, 3, 5, 8, 15)
#: The frames of a cell about a parcel, the pages that it hands on, and its reports.
SENT = cob.TPDO_BASES[2] + NODE, cob.PROGRAM_BASE + NODE, cob.EMCY_BASE + NODE
#: When the host repeats the program, a neighbour's wheels slip, and another lacks the program.
REPEATED, SLIPPED, LACKED = 5, 55, 75


class Random:
    """The same numbers on every interpreter."""

    def __init__(self, seed):
        self._state = seed * 7919 & 0x7FFF

    def below(self, limit):
        """A whole number from 0 on."""
        for _ in range(3):
            self._state = self._state * 1103 + 12_345 & 0x7FFF
        return (self._state >> 4) % limit


class Lived(Middle):
    """The cell, set up and not started yet; `liar` is a neighbour that believes otherwise."""

    def __init__(self):
        self.liar, self.identities = None, [IDENTITY] * 8
        self.sent = []
        super().__init__()

    def _boot(self):
        self._set_up()

    def _speeds(self, direction, speed_um_s):
        return super()._speeds(direction, 0 if direction == self.liar else speed_um_s)

    def _estimate(self, direction):
        fields = super()._estimate(direction)
        fields[wire.IDENTITY] = self.identities[direction]
        if direction == self.liar:
            fields[wire.X] += 160
        return fields

    def live(self, random, beats):
        """Beats of a cell at work, in some of which something happens."""
        self._start()
        for _ in range(40):
            self.beat(moving=False)
        for _ in range(beats):
            if random.below(6) == 0:
                self._happen(random)
            self.beat()

    def _happen(self, random):
        kind = random.below(9)
        if kind == 0:
            self.liar = random.below(8)
        elif kind == 1:
            self.silent = NEIGHBOURS[random.below(8)]
        elif kind == 2:
            self.losing = not self.losing
        elif kind == 3:
            self.lifted = not self.lifted
        elif kind == 4:
            self.identities[random.below(8)] = OTHER
        elif kind == 5:
            self._pass(BEAT_MS * (1 + random.below(4)))
        elif kind == 6:
            self.its_sequence = random.below(4)
            self.its_flags = wire.LACKING * random.below(2)
        elif kind == 7:
            identities = OTHER, IDENTITY
            self.cell.on_frame(cob.PROGRAM, pack_precedence(1, 2, 2, identities), self.now_ms)
        else:
            self._page((OTHER, wire.PARCEL, 1, wire.DISC, 900, 900, 44, 20, wire.GO_ON))
            self._page((OTHER, wire.GOAL, 1 + random.below(3), 100, 300, 0, 0, 0, 0))

    def stop(self):
        """The cell is stopped for a while."""
        self.cell.on_frame(cob.NMT, bytes((PRE_OPERATIONAL, NODE)), self.now_ms)
        self._pass(PAUSE_BEATS * BEAT_MS)

    def begin(self, now_ms, beat):
        """The time goes on to this instant and this beat, and the cell starts."""
        self._pass(now_ms - self.now_ms)
        self.cell._layer._heard.beat = beat
        self._start()

    def shown(self, beat):
        """The frames of the cell about the parcel in a beat, and the speeds of its wheels."""
        self.board.take()
        if beat == REPEATED:
            self._pages()
        elif beat == SLIPPED:
            self.liar = 2
        elif beat == LACKED:
            self.its_sequence, self.its_flags = 0, wire.LACKING
        self.beat()
        registers = self.cell._registers
        targets = registers[speed_loop.TARGET], registers[speed_loop.AXIS + speed_loop.TARGET]
        return [each for each in self.board.take() if each[0] in SENT], targets


#: These may stay: clocks, scratch, data that a known shape or a number of edges makes valid, and
#: words of a neighbour that count for no more beats.
STAYS = {"_came_ms", "_updated_ms", "_step_ms", "_period_ms", "_there", "_outline"}
STAYS |= {"_pose", "_middle_pose", "_sums", "_change", "_targets", "normal", "_box", "said"}
STAYS |= {"reach_um", "edge_late_ms", "node_id", "_registers", "_estimates", "nonsense"}


def state(layer):
    """All fields of the layer's parts that are numbers or arrays, by the place of the part."""
    tracking, pages = layer._tracking, layer._pages
    parts = [layer, layer._suspicion, layer._leading, layer._leading.steering, layer._rights]
    parts += [tracking, tracking.sensors, tracking.agreement, tracking.belief.twist]
    # MicroPython takes no star in a list.
    parts += [pages, pages.comparison, pages.precedence] + list(pages.programs._slots)  # noqa: RUF005
    fields = {}
    for number, part in enumerate(parts):
        for name, value in part.__dict__.items():
            if name not in STAYS and isinstance(value, (int, array, bytearray)):
                fields[number, name] = value if isinstance(value, int) else list(value)
    belief, heard = tracking.belief, layer._heard
    fields["belief"] = list(belief.pose), list(belief.covariance), belief.known, belief.way_um
    fields["heard"] = heard.edges, list(heard.estimate_beat), list(heard.boxes.fresh[:8])
    fields["seen"] = [bits & SEEN for bits in heard.presence]
    return fields


def started_after(seed):
    """A cell that starts after a life, and one that starts for the first time.

    Nothing has stayed in any part of the stopped one but clocks.
    """
    random = Random(seed)
    lived = Lived()
    lived.live(random, 20 + random.below(120))
    before = state(lived.cell._layer)
    lived.stop()
    fresh = Lived()
    after, never = state(lived.cell._layer), state(fresh.cell._layer)
    assert before != never
    for name, value in never.items():
        assert after[name] == value, (seed, name)
    # Its neighbours are as those of the other one, from now on.
    again = Lived()
    again.cell, again.board, again.now_ms = lived.cell, lived.board, lived.now_ms
    now_ms, beat = lived.now_ms + 1, lived.cell._layer._heard.beat
    again.begin(now_ms, beat)
    fresh.begin(now_ms, beat)
    return again, fresh


def test_nothing_before_a_stop_counts_after_it():
    for seed in some_of(SEEDS):
        kinds, drove = set(), False
        lived, fresh = started_after(seed)
        for beat in range(FOLLOWING_BEATS):
            shown = lived.shown(beat)
            assert shown == fresh.shown(beat), (seed, beat)
            kinds.update(can_id for can_id, _ in shown[0])
            drove = drove or shown[1][0] != 0
        assert drove
        assert kinds == set(SENT)
