"""Cells that have missed pages of their host, on every interpreter: none takes an old goal for new.

Each cell of four is the neighbour of all others, and they hand programs on. A goal's place tells
which one it is, for sequence numbers come round again after three.
"""

from array import array

from layer_bench import page_frame, some_of

from mdms_cell.canopen.objects import Objects, find
from mdms_cell.motion.pages import OUTDATED, Pages, ProgramComparison
from mdms_cell.motion.program import Program
from mdms_cell.perception.heard import Heard
from mdms_cell.perception.place import HOST, Place
from mdms_protocol import indices
from mdms_protocol.neighbours import frames as wire

PARCEL = 9
CELLS = 4
FRAME = find(indices.PROGRAM, 1).place


class Stand:
    """In place of what else a cell has: it is at the parcel, or not yet."""

    def __init__(self):
        self.identity = PARCEL
        self.registers = array("H", [0] * 18)
        self.host_lost = False
        self.under = True
        self.sending = False

    def begin(self, _identity):
        pass

    def next_leg(self):
        pass

    def take_shape(self, _program):
        pass

    def trigger(self, _number):
        self.sending = True


class Cell:
    def __init__(self, number):
        self.stand = stand = Stand()
        self.objects = Objects()
        self.heard = Heard()
        self.pages = Pages(
            self.objects,
            Place(self.objects, lambda: None),
            self.heard,
            tracking=stand,
            rights=stand,
            leading=stand,
            consumer=stand,
            pdos=stand,
        )
        self.pages.node_id = number
        self.verdict = 0

    @property
    def goal(self):
        """The number of the goal that the cell has; 0 without one."""
        program = self.pages.programs.find(PARCEL)
        return (
            program.place(0)[0] // wire.STEP_UM if program is not None and program.complete else 0
        )

    def take(self, direction, fields):
        self.pages.on_page(direction, page_frame(fields))

    def estimate(self):
        """Identity, sequence and flags that its estimate has."""
        program = self.pages.programs.complete(self.stand.identity)
        sequence = 0 if program is None or self.verdict == OUTDATED else program.sequence
        return self.stand.identity, sequence, 0 if sequence else wire.LACKING

    def hear(self, others):
        """A beat: the estimates of others, by direction; returns the page that it hands on."""
        heard, at_it = self.heard, self.stand.identity
        heard.beat += 1
        sent = 0
        for direction, said in others:
            at = direction * wire.ESTIMATE_FIELDS
            heard.estimates[at + wire.IDENTITY], heard.estimates[at + wire.SEQUENCE] = said[:2]
            heard.estimates[at + wire.FLAGS] = said[2]
            heard.estimates[at + wire.STATE] = wire.UNDER if said[0] else 0
            heard.estimate_beat[direction] = heard.beat
            sent |= 1 << direction
        program = self.pages.programs.complete(at_it)
        self.verdict = self.pages.comparison.update(at_it, program, sent)
        self.stand.sending = False
        if program is not None and not self.verdict:
            self.pages.hand_on(program, sent, 0)
        return bytes(self.objects.data[FRAME : FRAME + wire.LENGTH]) if self.stand.sending else None


class Table:
    """Four cells; `deaf` is a pair (hears, sends) of cells of which estimates get lost."""

    def __init__(self):
        self.cells = [Cell(number) for number in range(CELLS)]
        self.deaf = ()
        self.replaced = []

    def host_sends(self, goal, missing=()):
        """All pages of the program to this goal, from 1, and who misses them."""
        sequence = (goal - 1) % wire.SEQUENCE_MAX + 1
        for number, cell in enumerate(self.cells):
            if number not in missing:
                cell.take(HOST, (PARCEL, wire.PARCEL, sequence, 0, 1200, 1200, 44, 20, 0))
                cell.take(HOST, (PARCEL, wire.GOAL, sequence, goal, 0, 0, 0, 0, 0))

    def beats(self, count):
        for _ in range(count):
            said = [cell.estimate() for cell in self.cells]
            for number, cell in enumerate(self.cells):
                others = [
                    (other, said[other])
                    for other in range(CELLS)
                    if other != number and (number, other) != self.deaf
                ]
                page = cell.hear(others)
                if page is not None:
                    self.pass_on(number, page)

    def pass_on(self, sender, page):
        for number, cell in enumerate(self.cells):
            before = cell.goal
            if number != sender:
                cell.pages.on_page(sender, page)
            if cell.goal < before:
                self.replaced.append((number, before, cell.goal))

    def goals(self):
        return [cell.goal for cell in self.cells]


def who_misses(pattern):
    """Of each further goal the cells that miss it, from bits."""
    missing = []
    for _ in range(3):
        missing.append([number for number in range(CELLS) if pattern >> number & 1])
        pattern >>= CELLS
    return missing


def settled():
    """All cells have the first goal, and have heard so."""
    table = Table()
    table.host_sends(1)
    table.beats(3)
    return table


#: The host waits until all cells with a sensor under the parcel have a goal, or for so long. A cell
#: at the parcel's edge is not waited for: that is the first one here.
GIVEN_BEATS, WAITED_BEATS = 2, 50
AT_THE_EDGE = ([], [0])


def check(pattern):
    table = settled()
    for number, missing in enumerate(who_misses(pattern)):
        table.host_sends(number + 2, missing)
        table.beats(GIVEN_BEATS if missing in AT_THE_EDGE else WAITED_BEATS)
    table.beats(30)
    assert not table.replaced, (pattern, table.replaced)
    assert table.goals() == [4] * CELLS, (pattern, table.goals())


#: Which cells miss which of three goals, as bits; what most miss the host repeats.
FEW = [cells for cells in range(1 << CELLS) if bin(cells).count("1") <= CELLS // 2]
PATTERNS = [one | two << CELLS | three << 2 * CELLS for one in FEW for two in FEW for three in FEW]


def test_all_come_to_the_newest_goal_and_no_older_one_replaces_it_whatever_is_missed():
    for pattern in some_of(PATTERNS[::7]):
        check(pattern)


def test_cell_that_has_missed_two_goals_hands_nothing_on_and_is_given_the_newest():
    table = settled()
    for goal in (2, 3):
        table.host_sends(goal, missing=(1,))
    table.beats(1)
    assert table.goals() == [3, 1, 3, 3]
    table.beats(12)
    assert table.goals() == [3] * CELLS
    assert not table.replaced


def test_newcomer_with_an_old_goal_makes_nobody_take_it():
    # Goal 2 has the number of goal 5: a cell that has missed three in a row was without its host.
    for stale in (1, 3, 4):
        table = Table()
        newcomer = table.cells[2].stand
        newcomer.identity = 0
        for goal in range(1, 6):
            table.host_sends(goal, missing=() if goal <= stale else (2,))
            table.beats(3)
        newcomer.identity = PARCEL
        table.beats(20)
        assert table.goals() == [5] * CELLS, (stale, table.goals())
        assert not table.replaced


def test_newcomer_without_a_goal_is_given_it():
    table = Table()
    table.cells[2].stand.identity = 0
    table.host_sends(1, missing=(2,))
    table.beats(3)
    table.cells[2].stand.identity = PARCEL
    table.beats(10)
    assert table.goals() == [1] * CELLS


def test_newcomer_without_anything_is_handed_the_goal_and_then_the_parcel():
    cell = settled().cells[0]
    kinds = []
    for _ in range(8):
        page = cell.hear([(1, (PARCEL, 0, wire.LACKING))])
        if page is not None:
            kinds.append(page[0] >> 6)
    assert kinds == [wire.GOAL, wire.PARCEL]


def test_cell_that_has_heard_nobody_meanwhile_makes_nobody_take_its_old_goal():
    table = settled()
    silent = table.cells[3]
    others = table.cells[:3]
    for goal in (2, 3):
        table.host_sends(goal, missing=(3,))
        for _ in range(10):
            said = [cell.estimate() for cell in others]
            for number, cell in enumerate(others):
                cell.hear([(other, said[other]) for other in range(3) if other != number])
            silent.hear([])
    table.beats(20)
    assert table.goals() == [3] * CELLS
    assert not table.replaced


def test_cell_that_has_heard_nobody_for_three_goals_does_not_take_the_same_number_for_the_same():
    table = settled()
    others = table.cells[:3]
    for goal in (2, 3, 4):
        table.host_sends(goal, missing=(3,))
        for _ in range(10):
            said = [cell.estimate() for cell in others]
            for number, cell in enumerate(others):
                cell.hear([(other, said[other]) for other in range(3) if other != number])
            table.cells[3].hear([])
    assert table.goals() == [4, 4, 4, 1]
    table.beats(20)
    assert table.goals() == [4] * CELLS


def test_host_that_repeats_its_goal_settles_it():
    table = settled()
    table.host_sends(2, missing=(0, 1, 2))
    table.beats(1)
    table.host_sends(2)
    table.beats(1)
    assert [cell.verdict for cell in table.cells] == [0] * CELLS
    assert table.goals() == [2] * CELLS


def trusts_after(silent_beats):
    """Whether a neighbour's number still tells its program, after beats in which none was heard."""
    heard, program = Heard(), Program()
    program.take((PARCEL, wire.PARCEL, 2, 0, 1200, 1200, 44, 20, 0))
    program.take((PARCEL, wire.GOAL, 2, 1, 0, 0, 0, 0, 0))
    for field, value in ((wire.IDENTITY, PARCEL), (wire.STATE, wire.UNDER), (wire.SEQUENCE, 2)):
        heard.estimates[field] = value
    comparison = ProgramComparison(heard)

    def beat(hears):
        heard.beat += 10
        if hears:
            heard.estimate_beat[0] = heard.beat
        comparison.update(PARCEL, program, int(hears))

    for hears in [True, False, True] + [False] * silent_beats + [True]:
        beat(hears)
    return comparison.shared == 1


def test_a_number_tells_nothing_once_no_other_has_been_heard_for_ten_beats():
    assert trusts_after(9)
    assert not trusts_after(10)
