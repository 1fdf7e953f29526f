"""A cell that has restarted or was cut off alone: what it may promise, and when."""

from layer_bench import (
    IDENTITY,
    NEIGHBOURS,
    NODE,
    PITCH_UM,
    STEPS,
    Middle,
    estimates,
    page_frame,
    some_of,
)

from mdms_cell.rights.right_of_way import DEAD_BEATS
from mdms_protocol import indices
from mdms_protocol.codecs import cob
from mdms_protocol.neighbours import frames as wire

EAST, WEST = 0, 4
#: A parcel that overhangs the cell by 20 mm beside its sensors and wheels, and a waiting parcel.
LYING, WAITING = IDENTITY, 3
LENGTH_UM, WIDTH_UM = 200_000, 100_000
EDGE_UM = PITCH_UM // 2
#: A cell is silent about promises for so long after a restart.
BOUND_BEATS = 31
PLENTY = 60


class Restarted(Middle):
    """The cell, just up; `reports` has who of its neighbours reports which parcel, and where.

    By direction: identity, x of its centre from the cell's own, and whether it asks for the cell.
    `known` are the parcels whose pages the host has sent, `alive` the neighbours that are heard.
    """

    def __init__(self, reports, known=(LYING, WAITING), alive=range(8)):
        self.reports = dict(reports)
        self.known = known
        self.alive = set(alive)
        #: The announcements of the cell: identity and state, when they changed.
        self.said = []
        #: The flags of its last estimate.
        self.flags = 0
        super().__init__(0)

    def _pages(self):
        for identity in self.known:
            self.parcel_page(identity)

    def parcel_page(self, identity, direction=None):
        size = (LENGTH_UM // wire.STEP_UM, WIDTH_UM // wire.STEP_UM)
        head = (identity, wire.PARCEL, 1, wire.RECTANGLE)
        node = None if direction is None else NEIGHBOURS[direction]
        can_id = cob.PROGRAM if node is None else cob.TPDO_BASES[3] + node
        fields = head + size + (44, 20)
        self.cell.on_frame(can_id, page_frame(fields), self.now_ms)

    def _covered(self, _x_um, _y_um):
        return 0

    def _presence(self, direction):
        if direction in self.alive:
            super()._presence(direction)

    def beat(self, moving=False):
        self.unheard = [each for each in range(8) if each not in self.alive]
        super().beat(moving)
        for fields in estimates(self):
            self.flags = fields[wire.FLAGS]
            said = (fields[wire.IDENTITY], fields[wire.STATE])
            if not self.said or self.said[-1] != said:
                self.said.append(said)

    def _estimate(self, direction):
        if direction not in self.alive or direction not in self.reports:
            return None
        identity, x_um, asks = self.reports[direction]
        return {
            wire.X: (x_um - STEPS[direction][0] * PITCH_UM) // wire.STEP_UM,
            wire.IDENTITY: identity,
            wire.STATE: self._state(identity),
            wire.CERTAINTY: self.certainty,
            wire.WANTS: 1 << (direction ^ 4) if asks else 0,
            wire.SEQUENCE: 1,
        }

    def _state(self, _identity):
        return wire.UNDER

    def promised(self, beats):
        """The parcel that the cell is promised to after this many beats, 0 for none."""
        for _ in range(beats):
            self.beat()
        identity, state = self.said[-1] if self.said else (0, 0)
        return identity if state >= wire.PROMISED else 0

    def promises(self):
        """All that it has been promised to."""
        return {identity for identity, state in self.said if state >= wire.PROMISED}


class Vague(Restarted):
    """Its neighbours have no poses."""

    certainty = 0


class AllRestarted(Restarted):
    """Those around the lying parcel are up as late: near it, and without a word now and then."""

    def _state(self, identity):
        return wire.NEAR if identity == LYING else wire.UNDER

    def _estimate(self, direction):
        without = direction in self.reports and self.reports[direction][0] == LYING
        return None if without and self.now_ms // 10 % 8 == 0 else super()._estimate(direction)


class CutOff(Restarted):
    """It gives the beat itself where it hears no other."""

    def _start(self):
        self._write(indices.LEASE, 3, 1, 1)
        super()._start()

    def alone(self, time_ms):
        """Let time pass without a frame of others; return the announcements that wait meanwhile."""
        self.board.take()
        for _ in range(time_ms):
            self._pass(1)
        return [(fields[wire.IDENTITY], fields[wire.STATE]) for fields in estimates(self)]


def overhangs(identity, side, by_um=20_000):
    """It lies over the cell's edge, from a side."""
    sign = 1 if side == EAST else -1
    return identity, sign * (EDGE_UM - by_um + LENGTH_UM // 2), True


def waits(identity, side):
    """It stands beside the cell, and asks for it."""
    sign = 1 if side == EAST else -1
    return identity, sign * (EDGE_UM + 5_000 + LENGTH_UM // 2), True


def test_square_belongs_to_the_parcel_that_lies_over_it_though_another_asks():
    parcels = ((LYING, WAITING), (WAITING, LYING))
    for side, (lying, waiting) in some_of([(s, each) for s in (EAST, WEST) for each in parcels]):
        reports = {side: overhangs(lying, side), side ^ 4: waits(waiting, side ^ 4)}
        middle = Restarted(reports)
        assert middle.promised(PLENTY) == lying
        assert middle.promises() == {lying}
        # Once it has left, the other may come.
        middle.reports = {side ^ 4: waits(waiting, side ^ 4)}
        assert middle.promised(PLENTY) == waiting


def test_square_that_two_parcels_lie_over_is_promised_to_none():
    middle = Restarted({EAST: overhangs(LYING, EAST), WEST: overhangs(WAITING, WEST)})
    assert middle.promised(PLENTY) == 0
    assert not middle.promises()


def test_square_belongs_to_the_parcel_that_lies_over_it_though_the_cells_around_it_restarted_too():
    middle = AllRestarted({EAST: overhangs(LYING, EAST), WEST: waits(WAITING, WEST)})
    assert middle.promised(PLENTY) == 0
    assert middle.promises() == set()


def test_free_square_is_promised_to_the_one_that_asks():
    middle = Restarted({WEST: waits(WAITING, WEST)})
    assert middle.promised(PLENTY) == WAITING


def test_nothing_is_promised_before_every_living_neighbour_is_heard():
    for silent in some_of(range(8)):
        alive = [each for each in range(8) if each != silent]
        asks_from = WEST if silent != WEST else EAST
        middle = Restarted({asks_from: waits(WAITING, asks_from)}, alive=alive)
        assert middle.promised(PLENTY) == 0
        # It comes up late, with a parcel or without.
        middle.alive.add(silent)
        assert middle.promised(PLENTY) == WAITING


def test_parcel_of_a_neighbour_that_is_heard_late_counts():
    reports = {EAST: overhangs(LYING, EAST), WEST: waits(WAITING, WEST)}
    middle = Restarted(reports, alive=[each for each in range(8) if each != EAST])
    assert middle.promised(PLENTY) == 0
    middle.alive.add(EAST)
    assert middle.promised(PLENTY) == LYING
    assert middle.promises() == {LYING}


def test_neighbour_that_is_silent_for_two_seconds_is_dead():
    alive = [each for each in range(8) if each != EAST]
    middle = Restarted({WEST: waits(WAITING, WEST)}, alive=alive)
    # 40 beats have passed while it came up.
    assert middle.promised(DEAD_BEATS - 60) == 0
    assert middle.promised(30) == WAITING


def test_report_of_a_neighbour_that_dies_after_it_counts():
    middle = Restarted({EAST: overhangs(LYING, EAST), WEST: overhangs(WAITING, WEST)})
    middle.alive.discard(EAST)
    assert middle.promised(DEAD_BEATS + PLENTY) == 0


def test_parcel_of_unknown_size_is_asked_for_and_keeps_others_away_meanwhile():
    for asks in (False, True):
        identity, x_um, _ = overhangs(LYING, EAST)
        reports = {EAST: (identity, x_um, asks), WEST: waits(WAITING, WEST)}
        middle = Restarted(reports, known=(WAITING,))
        assert middle.promised(PLENTY) == (LYING if asks else 0)
        assert middle.said[-1] == (LYING, wire.PROMISED if asks else wire.NEAR)
        assert middle.flags & wire.LACKING
        middle.parcel_page(LYING, EAST)
        middle.reports[EAST] = (identity, x_um, True)
        assert middle.promised(PLENTY) == LYING
        assert middle.promises() == {LYING}


def test_parcel_of_which_nobody_has_a_pose_may_come_where_it_alone_is_reported():
    middle = Vague({WEST: waits(WAITING, WEST)})
    assert middle.promised(PLENTY) == WAITING


def test_it_may_not_where_a_sensor_is_covered_which_something_else_may_do():
    class Covered(Vague):
        def _covered(self, _x_um, _y_um):
            return 1

    middle = Covered({WEST: waits(WAITING, WEST)})
    assert middle.promised(PLENTY) == 0


def test_parcel_of_which_nobody_has_a_pose_keeps_others_away():
    middle = Vague({EAST: overhangs(LYING, EAST), WEST: waits(WAITING, WEST)})
    assert middle.promised(PLENTY) == 0


def test_cell_is_as_unsure_after_each_restart():
    reports = {WEST: waits(WAITING, WEST)}
    middle = Restarted(reports)
    assert middle.promised(PLENTY) == WAITING
    for command in (128, 1):
        middle.cell.on_frame(cob.NMT, bytes((command, NODE)), middle.now_ms)
    middle._pages()
    middle.said = []
    middle.reports[EAST] = overhangs(LYING, EAST)
    assert middle.promised(BOUND_BEATS - 2) == 0
    assert middle.promised(PLENTY) == LYING
    assert middle.promises() == {LYING}


def test_promise_of_a_cell_that_was_alone_lasts_until_it_has_run_out_where_it_comes_late():
    cell = CutOff({WEST: waits(LYING, WEST)})
    assert cell.promised(PLENTY) == LYING
    assert (LYING, wire.PROMISED) in cell.alone(1000)
    # Its neighbours get that only now, and another parcel asks.
    cell.reports = {EAST: waits(WAITING, EAST)}
    assert cell.promised(BOUND_BEATS - 1) != WAITING
    assert cell.promised(5) == WAITING
