"""How a cell handles lost frames of its neighbours, on every interpreter."""

from layer_bench import IDENTITY, NODE, Middle, estimate_of, state, targets_um_s

from mdms_protocol.codecs import cia402, cob
from mdms_protocol.neighbours import frames as wire

SPEED_UM_S = 100_000


def run(middle, beats):
    for _ in range(beats):
        middle.beat()
        sent = middle.board.take()
    return sent


class Alone(Middle):
    """A cell that has nothing but its own sensors, its neighbours' and all wheels to go by."""

    certainty = 0

    def off_um(self):
        """How far along x the pose is from the truth that was sent last."""
        fields = estimate_of(dict(run(self, 1))[cob.TPDO_BASES[2] + NODE])
        assert fields[wire.CERTAINTY]
        return fields[wire.X] * wire.STEP_UM - self.x_um + self.speed_um_s * 10 // 1000


def lose(cell, before, beats):
    """States are lost in some beats; the parcel leaves the first western sensors in them.

    Just before all neighbours have sent theirs.
    """
    run(cell, before)
    cell.words = bytes((0x37, 2, 0x33, 2))
    assert abs(cell.off_um()) < 1_500
    cell.losing = True
    run(cell, beats)
    cell.losing = False


def test_state_that_is_repeated_after_a_lost_one_moves_no_belief():
    cell = Alone(SPEED_UM_S)
    lose(cell, 75, 12)
    run(cell, 22)
    assert abs(cell.off_um()) < 3_000


def test_side_that_leaves_sensors_shows_the_place_as_one_that_comes_does():
    for off_um in (-6_000, 6_000):
        cell = Alone(SPEED_UM_S)
        run(cell, 48)
        cell.cell._layer._tracking.belief.pose[0] += off_um
        run(cell, 1)
        assert abs(cell.off_um() - off_um) < 1_000
        run(cell, 45)
        assert abs(cell.off_um()) < 1_500, off_um


def test_state_that_is_sent_for_its_statuswords_shows_no_edge():
    cell = Alone(SPEED_UM_S)
    lose(cell, 75, 12)
    run(cell, 5)
    off_um = cell.off_um()
    cell.words = bytes((0x37, 2, 0x37, 2))
    run(cell, 1)
    assert abs(cell.off_um() - off_um) < 1_000


def test_state_with_an_edge_that_another_has_left_behind_shows_none():
    cell = Alone(180_000)
    lose(cell, 42, 5)
    run(cell, 12)
    off_um = cell.off_um()
    # Two sensors were left 30 mm ago, and the one behind them now.
    run(cell, 4)
    assert abs(cell.off_um() - off_um) < 2_000


def test_wheel_joins_a_parcel_under_way_once_others_show_how_it_moves():
    middle = Middle(SPEED_UM_S)
    middle._page((IDENTITY, wire.END, 1, 0, 0, 0, 0, 0, 0))
    middle.sequence = 2
    middle._pages()
    middle.unheard = range(8)
    run(middle, 15)
    assert state(middle) == cia402.SWITCHED_ON
    middle.unheard = ()
    run(middle, 5)
    assert state(middle) == cia402.OPERATION_ENABLED
    assert targets_um_s(middle)[0] > 90_000
