"""A free cell that two parcels ask for, and an order of the host, on every interpreter."""

from layer_bench import NODE, STEPS, Middle, estimates

from mdms_protocol import indices
from mdms_protocol.codecs import cob
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours.precedence import is_precedence, pack_precedence

FIRST, SECOND, OTHER = 9, 7, 6
EAST, WEST = 0, 4
#: From a neighbour's centre to that of a parcel of 0.3 m, away from the cell [steps of the wire].
ASIDE = 400
NMT_START, NMT_PRE_OPERATIONAL = 1, 128
#: So long a promise that nobody asks for any more is kept, and then nobody is promised anything.
LAPSED = 60
#: How long a parcel counts as there after it has left: under a neighbour, and elsewhere.
NEAR, FAR = 510, 50


class Asked(Middle):
    """The cell; `asking` are the identities of parcels on neighbours, by direction."""

    def __init__(self):
        self.asking = {}
        self.standing = {}
        super().__init__(0)
        self._write(indices.CONSUMER_TIMES, 1, 4, (cob.HOST_NODE << 16) | 75)
        for identity in (FIRST, SECOND, OTHER):
            self.program(identity)
        self.beats(60, with_host=True)

    def program(self, identity):
        self._page((identity, wire.PARCEL, 1, wire.DISC, 1200, 1200, 44, 20, wire.GO_ON))
        self._page((identity, wire.GOAL, 1, 0, 0, 0, 0, 0, 0))

    def _pages(self):
        """No parcel lies on the cell."""

    def _covered(self, _x_um, _y_um):
        return 0

    def _estimate(self, direction):
        asks = direction in self.asking
        identity = self.asking.get(direction) or self.standing.get(direction)
        if not identity:
            return None
        fields = super()._estimate(direction)
        # It lies beside the cell's square.
        dx, dy = STEPS[direction]
        fields[wire.X], fields[wire.Y] = dx * ASIDE, dy * ASIDE
        fields[wire.IDENTITY] = identity
        fields[wire.WANTS] = 1 << (direction ^ 4) if asks else 0
        return fields

    def order(self, number, *identities, column=2):
        """The host sends the order over the cell, or over one in another column."""
        frame = pack_precedence(number, column, 2, identities)
        self.cell.on_frame(cob.PROGRAM, frame, self.now_ms)

    def beats(self, count, with_host=False):
        """The parcel that the cell is promised to after this many beats; 0: nobody."""
        promised = 0
        for _ in range(count):
            if with_host:
                self.cell.on_frame(cob.HEARTBEAT_BASE + cob.HOST_NODE, b"\x05", self.now_ms)
            self.beat()
            for fields in estimates(self):
                promised = fields[wire.IDENTITY] if fields[wire.STATE] >= wire.PROMISED else 0
        return promised

    def comes_and_leaves(self, identity, direction):
        """A parcel comes over the cell and leaves it again, for a neighbour."""
        self.asking = {direction: identity}
        assert self.beats(LAPSED) == identity
        x = 120 if direction == EAST else -120
        self._page((identity, wire.PLACE, 1, x, 0, 0, 0, 0, 0))
        self.beats(3)
        self._page((identity, wire.END, 1, 0, 0, 0, 0, 0, 0))
        self.asking, self.standing = {}, {direction: identity}


def alone():
    """The host has sent an order, and is gone."""
    asked = Asked()
    asked.order(1, FIRST, SECOND)
    asked.beats(20)
    return asked


def test_parcel_whose_turn_it_is_not_gets_no_promise_without_the_host():
    asked = alone()
    asked.asking = {EAST: SECOND}
    assert asked.beats(60) == 0
    asked.asking = {EAST: SECOND, WEST: FIRST}
    assert asked.beats(60) == FIRST


def test_while_the_host_is_there_the_first_parcel_is_promised_the_cell():
    asked = Asked()
    asked.order(1, FIRST, SECOND)
    asked.asking = {EAST: SECOND}
    assert asked.beats(60, with_host=True) == SECOND


def test_order_over_another_cell_and_garbage_change_nothing():
    asked = Asked()
    asked.order(1, FIRST, SECOND, column=3)
    for data in (
        bytes(7),
        bytes((0, 2, 2, FIRST, 0, SECOND, 0, 0)),
        bytes((0, 2, 2, 64, 0, 0, 0, 0)),
    ):
        assert not is_precedence(data)
        dropped = asked.cell.dropped
        asked.cell.on_frame(cob.PROGRAM, data, asked.now_ms)
        assert asked.cell.dropped == dropped + 1
    asked.beats(20)
    asked.asking = {EAST: SECOND}
    assert asked.beats(60) == SECOND


def test_order_that_ends_lets_anybody_come():
    asked = Asked()
    asked.order(1, FIRST, SECOND)
    asked.order(2)
    asked.beats(20)
    asked.asking = {EAST: SECOND}
    assert asked.beats(60) == SECOND


def test_order_is_none_after_a_restart():
    asked = alone()
    for command in (NMT_PRE_OPERATIONAL, NMT_START):
        asked.cell.on_frame(cob.NMT, bytes((command, NODE)), asked.now_ms)
        asked.beats(5)
    asked.program(SECOND)
    asked.asking = {EAST: SECOND}
    assert asked.beats(60) == SECOND


def test_parcel_that_is_in_no_order_is_promised_the_cell():
    asked = alone()
    asked.asking = {EAST: OTHER}
    assert asked.beats(60) == OTHER


def test_next_one_waits_until_the_one_before_has_gone():
    asked = alone()
    asked.comes_and_leaves(FIRST, WEST)
    asked.asking = {EAST: SECOND}
    assert asked.beats(NEAR - 100) == 0
    asked.standing = {}
    assert asked.beats(FAR + LAPSED) == SECOND


def test_one_that_stays_beside_the_cell_has_gone_after_a_while():
    asked = alone()
    asked.comes_and_leaves(FIRST, WEST)
    asked.asking = {EAST: SECOND}
    assert asked.beats(NEAR + LAPSED) == SECOND


def test_order_that_is_repeated_does_not_begin_again_and_a_new_number_does():
    asked = alone()
    asked.comes_and_leaves(FIRST, WEST)
    asked.standing = {}
    asked.beats(FAR)
    asked.order(1, FIRST, SECOND)
    asked.asking = {EAST: SECOND}
    assert asked.beats(LAPSED) == SECOND
    asked.asking = {}
    asked.beats(LAPSED)
    asked.order(2, FIRST, SECOND)
    asked.asking = {EAST: SECOND}
    assert asked.beats(LAPSED) == 0


def test_a_parcel_that_waits_in_vain_gets_the_cell_at_last():
    asked = alone()
    asked.asking = {EAST: SECOND}
    asked.beats(1)
    asked.cell._layer._pages.precedence._kept_beats += 1400  # for which nobody waits
    assert asked.beats(80) == 0
    assert asked.beats(100) == SECOND
