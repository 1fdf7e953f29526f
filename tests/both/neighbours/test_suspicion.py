"""How a cell judges neighbours that contradict it, and itself."""

from cell_bench import NODE
from layer_bench import IDENTITY, NEIGHBOURS, STEPS, Middle, estimate_of, some_of

from mdms_protocol import indices
from mdms_protocol.codecs import cob
from mdms_protocol.neighbours import frames as wire

EAST, NORTH, WEST = 0, 2, 4
PRESENCE, WHEELS, POSE, SILENCE = 1, 2, 4, 8


class Broken(Middle):
    """One neighbour is broken while `broken`; the reports of the cell are kept by beat."""

    def __init__(self, speed_um_s=40_000):
        self.broken = False
        self.reports = []
        self.estimate = None
        super().__init__(speed_um_s)

    def beats(self, count):
        """Pass beats; the suspects that were reported meanwhile, 0 for none any more."""
        for _ in range(count):
            self.beat()
            for can_id, data in self.board.take():
                if can_id == cob.EMCY_BASE + NODE:
                    suspicion = data[0] | data[1] << 8 == 0xFF01
                    self.reports.append((data[4], data[5]) if suspicion else None)
                elif can_id == cob.TPDO_BASES[2] + NODE:
                    self.estimate = estimate_of(data)
        reports, self.reports = self.reports, []
        return reports

    def suspect(self):
        """Object 0x3015."""
        head = bytes((0x40, indices.SUSPECT & 0xFF, indices.SUSPECT >> 8, 0))
        self.cell.on_frame(cob.SDO_REQUEST_BASE + NODE, head + bytes(4), self.now_ms)
        (answer,) = [data for can_id, data in self.board.take() if can_id == 0x580 + NODE]
        return answer[4]


class Blind(Broken):
    """The eastern neighbour's sensors see nothing."""

    def _covered(self, x_um, y_um):
        bits = super()._covered(x_um, y_um)
        return 0 if self.broken and x_um > 0 and not y_um else bits


def test_neighbour_that_sees_nothing_under_the_parcel_is_suspected_after_half_a_second():
    cell = Blind()
    assert cell.beats(30) == []
    cell.broken = True
    assert cell.beats(40) == []
    assert cell.beats(30) == [(NEIGHBOURS[EAST], PRESENCE)]
    assert cell.estimate[wire.FLAGS] & wire.CONTRADICTED
    assert cell.suspect() == NEIGHBOURS[EAST]


def test_neighbour_is_suspected_in_whatever_direction_it_is():
    class Faulty(Broken):
        def _covered(self, x_um, y_um):
            bits = super()._covered(x_um, y_um)
            here = (x_um > 0) - (x_um < 0), (y_um > 0) - (y_um < 0)
            return 0 if self.blind and here == STEPS[self.direction] else bits

        def _estimate(self, direction):
            silent = self.silenced and direction == self.direction
            return None if silent else super()._estimate(direction)

    cases = [(direction, fault) for direction in range(8) for fault in (PRESENCE, SILENCE)]
    for direction, fault in some_of(cases):
        Faulty.direction, Faulty.blind, Faulty.silenced = direction, False, False
        cell = Faulty(0)
        cell.blind, cell.silenced = fault == PRESENCE, fault == SILENCE
        assert cell.beats(75) == [(NEIGHBOURS[direction], fault)]


def test_suspect_that_agrees_for_as_long_is_one_no_more():
    cell = Blind()
    cell.broken = True
    assert cell.beats(70)
    cell.broken = False
    assert cell.beats(40) == []
    assert cell.beats(30) == [None]
    assert not cell.estimate[wire.FLAGS] & wire.CONTRADICTED
    assert cell.suspect() == 0


class Blinded(Broken):
    """The cell's own sensors see nothing."""

    def _covered(self, x_um, y_um):
        bits = super()._covered(x_um, y_um)
        return 0 if self.broken and not x_um and not y_um else bits


def test_cell_that_alone_sees_nothing_suspects_itself_and_keeps_the_parcel():
    cell = Blinded(0)
    cell.broken = True
    # Until then it is in doubt, and does not steer.
    assert cell.beats(40) == []
    assert cell.estimate[wire.CERTAINTY] == 0
    assert cell.beats(30) == [(NODE, PRESENCE)]
    cell.beats(120)
    assert cell.estimate[wire.STATE] == wire.UNDER
    assert cell.estimate[wire.CERTAINTY] > 0


def test_parcel_that_all_cells_miss_is_dropped():
    class Gone(Broken):
        def _covered(self, _x_um, _y_um):
            return 0

        def _estimate(self, direction):
            fields = super()._estimate(direction)
            if self.broken:
                # They are no longer certain either.
                fields[wire.CERTAINTY] = 0
            return fields

    cell = Gone(0)
    cell.broken = True
    cell.beats(130)
    assert cell.estimate[wire.STATE] != wire.UNDER


def test_neighbour_that_believes_the_parcel_elsewhere_drags_nobody_away():
    class Misplaced(Broken):
        def _estimate(self, direction):
            fields = super()._estimate(direction)
            if self.broken and direction == EAST:
                fields[wire.X] += 127_000 // wire.STEP_UM
            return fields

    cell = Misplaced()
    cell.broken = True
    assert cell.beats(70) == [(NEIGHBOURS[EAST], POSE)]
    assert abs(cell.estimate[wire.X] * wire.STEP_UM - cell.x_um) < 4_000


def test_outvoted_cell_takes_the_belief_of_the_others():
    class Wrong(Broken):
        placed_y_um = 40_000

    cell = Wrong(0)
    assert cell.beats(70) == []
    assert abs(cell.estimate[wire.Y] * wire.STEP_UM) < 4_000


def test_wheel_that_does_not_turn_with_the_parcel_is_suspected():
    class Stuck(Broken):
        def _speeds(self, direction, speed_um_s):
            stuck = self.broken and direction == NORTH
            return super()._speeds(direction, 0 if stuck else speed_um_s)

    cell = Stuck()
    assert cell.beats(20) == []
    cell.broken = True
    assert cell.beats(70) == [(NEIGHBOURS[NORTH], WHEELS)]


def test_neighbour_that_the_parcel_needs_and_that_is_silent_is_suspected():
    class Silent(Broken):
        def _estimate(self, direction):
            return None if self.broken and direction == WEST else super()._estimate(direction)

    cell = Silent()
    assert cell.beats(20) == []
    cell.broken = True
    assert cell.beats(80) == [(NEIGHBOURS[WEST], SILENCE)]
    assert cell.estimate[wire.HOLD] == 0


def test_cell_that_finds_itself_among_its_neighbours_takes_no_part():
    class Elsewhere(Broken):
        neighbours = (NODE,) + NEIGHBOURS[1:]  # noqa: RUF005 - not in MicroPython

    cell = Elsewhere()
    assert cell.beats(60) == []
    assert cell.estimate is None


class Corner(Broken):
    """A parcel's side lies over the cell's square in the west, short of wheels and sensors.

    While `broken` another parcel in the east, of a lower identity, wants the cell for itself.
    """

    def __init__(self):
        super().__init__(0)

    def _boot(self):
        self.x_um = -235_000
        super()._boot()

    def _estimate(self, direction):
        if direction in (3, 4, 5):
            return self._wanting(super()._estimate(direction), IDENTITY, 0)
        if direction in (0, 1, 7) and self.broken:
            return self._wanting(super()._estimate(direction), IDENTITY - 1, wire.HOLD_NONE)
        return None

    def _wanting(self, fields, identity, hold):
        fields[wire.IDENTITY], fields[wire.HOLD], fields[wire.WANTS] = identity, hold, 0xFF
        return fields


def test_cell_stays_with_a_parcel_that_lies_over_its_square_only_and_is_held():
    cell = Corner()
    cell.beats(80)
    assert cell.estimate[wire.IDENTITY] == IDENTITY
    cell.broken = True
    for _ in range(30):
        cell.beats(10)
        assert cell.estimate[wire.IDENTITY] == IDENTITY
