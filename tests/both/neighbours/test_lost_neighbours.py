"""A neighbour that the host declares lost, for a parcel over it, on every interpreter."""

from layer_bench import IDENTITY, NODE, Middle, estimates

from mdms_cell.perception.heard import NEVER, SPEEDS_AT
from mdms_protocol.codecs import cob
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours import lost

EAST_NODE, COLUMN, ROW = 6, 3, 2
OWN_COLUMN = 2
OTHER = 9
LEASE_BEATS = 10
#: By then its promise has run out.
DIED_BEATS = 20


class Beside(Middle):
    """The cell; its neighbour in the east has died under the parcel that both are under."""

    def __init__(self, silent_beats=lost.LOST_BEATS + 1):
        super().__init__(0)
        self.number = 0
        self.silent = EAST_NODE
        self.hold = self.rest(DIED_BEATS)
        # It died so much longer ago.
        heard, more_beats = self.cell._layer._heard, silent_beats - DIED_BEATS
        for dates, place in ((heard.estimate_beat, 0), (heard.boxes.stamps, SPEEDS_AT)):
            dates[place] = dates[place] - more_beats & NEVER - 1

    def rest(self, beats):
        """So many beats; returns the last `hold` that the cell has sent."""
        hold = None
        for _ in range(beats):
            self.beat(moving=False)
            for fields in estimates(self):
                hold, self.state = fields[wire.HOLD], fields[wire.STATE]
        return hold

    def page(self, number, identity=IDENTITY, kind=lost.DECLARED, column=COLUMN):
        """The host sends a page; returns the kind of the answer, None without one."""
        self.board.take()
        page = lost.pack_lost(kind, column, ROW, identity, number)
        self.cell.on_frame(cob.PROGRAM, page, self.now_ms)
        self._pass(0)
        answers = [data for can_id, data in self.board.take() if can_id == cob.TPDO_BASES[3] + NODE]
        for answer in answers:
            assert lost.is_lost(answer), answer
            assert answer[1:] == page[1:]
        return lost.kind_of(answers[-1]) if answers else None

    def rounds(self, count):
        """So many rounds, two beats apart; returns `hold` after the last."""
        hold = None
        for _ in range(count):
            self.number = self.number % lost.NUMBER_MAX + 1
            assert self.page(self.number) == lost.AGREED
            hold = self.rest(2)
        return hold


def test_cell_stands_before_a_dead_neighbour_that_nobody_has_declared():
    assert Beside().hold == 0


def test_cell_refuses_a_neighbour_that_it_has_heard_lately():
    beside = Beside(silent_beats=lost.LOST_BEATS - 20)
    assert beside.page(1) == lost.REFUSED
    assert beside.page(2) == lost.REFUSED
    assert beside.rest(2) == 0


def test_first_round_lets_no_wheel_turn_and_the_second_does():
    beside = Beside()
    assert beside.rounds(1) == 0
    assert beside.rounds(1) == wire.HOLD_NONE
    assert beside.rounds(20) == wire.HOLD_NONE


def test_round_after_the_highest_number_is_the_next_one():
    beside = Beside()
    beside.number = lost.NUMBER_MAX - 3
    assert beside.rounds(2) == wire.HOLD_NONE
    for _ in range(4):
        beside.number = beside.number % lost.NUMBER_MAX + 1
        assert beside.page(beside.number) == lost.AGREED
        for _ in range(3):
            assert beside.rest(1) == wire.HOLD_NONE


def test_neighbour_that_died_days_ago_is_as_dead_where_the_count_of_beats_comes_round():
    beside = Beside()
    heard = beside.cell._layer._heard
    assert beside.rounds(3) == wire.HOLD_NONE
    come_round = heard.beat - heard.age(0)
    for beat in range(heard.beat | 0xFFFF, NEVER + come_round - 20, 1 << 16):
        heard.beat = beat
        heard.begin_beat(beside.cell._registers)
    heard.beat = NEVER + come_round - 20 & NEVER - 1
    beside.rest(40)
    assert beside.rounds(20) == wire.HOLD_NONE


def test_silence_of_the_host_ends_the_declaration_within_a_lease():
    beside = Beside()
    assert beside.rounds(3) == wire.HOLD_NONE
    assert beside.rest(LEASE_BEATS) == 0


def test_round_that_begins_anew_lets_no_wheel_turn():
    beside = Beside()
    for number in range(1, 40, 2):
        assert beside.page(number) == lost.AGREED
        assert beside.rest(2) == 0


def test_page_that_comes_twice_or_late_prolongs_nothing():
    beside = Beside()
    assert beside.rounds(3) == wire.HOLD_NONE
    for _ in range(LEASE_BEATS):
        assert beside.page(beside.number) == lost.AGREED
        assert beside.page(beside.number - 1) == lost.REFUSED
        hold = beside.rest(1)
    assert hold == 0
    # The next number after so long does not show that all agree now.
    assert beside.page(beside.number + 1) == lost.AGREED
    assert beside.rest(2) == 0


def test_cell_under_one_parcel_refuses_another():
    beside = Beside()
    for number in range(1, 10):
        assert beside.page(number, OTHER) == lost.REFUSED
        assert beside.rest(2) == 0


def test_cell_that_hears_its_neighbour_again_refuses_and_does_not_count_on_it_until_revoked():
    beside = Beside()
    assert beside.rounds(3) == wire.HOLD_NONE
    beside.silent = None
    beside.rest(2)
    assert beside.page(beside.number + 1) == lost.REFUSED
    assert beside.rest(50) == 0
    assert beside.page(beside.number + 2, kind=lost.REVOKED) == lost.REVOKED
    assert beside.rest(10) == wire.HOLD_NONE


def test_pages_of_neighbours_and_about_far_cells_change_nothing():
    beside = Beside()
    for number in range(1, 10):
        page = lost.pack_lost(lost.DECLARED, COLUMN, ROW, IDENTITY, number)
        beside.cell.on_frame(cob.TPDO_BASES[3] + EAST_NODE, page, beside.now_ms)
        assert beside.page(number, column=COLUMN + 1) is None
        assert beside.rest(2) == 0


def test_declared_cell_that_is_back_refuses_and_promises_nothing():
    beside = Beside()
    beside.silent = None
    assert beside.rest(40) == wire.HOLD_NONE
    for number in range(1, 30):
        assert beside.page(number, column=OWN_COLUMN) == lost.REFUSED
        beside.rest(2)
        assert beside.state < wire.PROMISED
    # Once nobody declares it any more, it finds the parcel by its neighbours.
    assert beside.rest(60) == wire.HOLD_NONE


def test_frames_that_are_no_such_page_are_told_from_it():
    page = lost.pack_lost(lost.DECLARED, COLUMN, ROW, IDENTITY, 0x1234)
    assert lost.is_lost(page)
    assert lost.number_of(page) == 0x1234
    for place, value in ((0, 1), (1, 2), (2, 0), (3, 0), (4, 0), (4, 64), (7, 1)):
        wrong = bytearray(page)
        wrong[place] = value
        assert not lost.is_lost(wrong)
    assert not lost.is_lost(page[:7])
    assert not lost.is_lost(lost.pack_lost(lost.DECLARED, COLUMN, ROW, IDENTITY, 0))
