import numpy as np
import pytest

from mdms_host.estimation.footprint import Disc, Footprint, Rectangle
from mdms_host.estimation.locating import Search
from mdms_host.layout import Layout

LAYOUT, BOTTOM = Layout(6, 3), Rectangle(0.36, 0.30)
SENSORS_M = LAYOUT.sensor_positions_m.reshape(-1, 2)
TRUTH = np.array([0.03, 0.01, 0.2])


def searched(covered: np.ndarray, footprint: Footprint = BOTTOM) -> tuple[Search, int]:
    search = Search(footprint, LAYOUT, covered, np.ones(len(covered), dtype=bool), 0.0)
    steps = 0
    while not search.over:
        search.step()
        steps += 1
    return search, steps


def test_sensors_that_agree_need_one_step() -> None:
    search, steps = searched(BOTTOM.distance_m(SENSORS_M, TRUTH) < 0)
    assert steps == 1
    assert search.found is not None
    assert not search.left_out.any()


def test_a_parcel_with_much_room_around_what_it_covers_needs_some_short_steps() -> None:
    layout, large = Layout(9, 6), Rectangle(0.9, 0.9)
    covered = large.distance_m(layout.sensors_m, np.array([-0.5, -0.3, 0.1])) < 0
    mine = np.ones(len(covered), dtype=bool)
    search = Search(large, layout, covered, mine, 0.0)
    search.step()
    assert not search.tried
    steps = 1
    while not search.over:
        search.step()
        steps += 1
    assert 2 <= steps <= 20
    assert search.found is not None
    assert np.hypot(*(search.found.pose - (-0.5, -0.3, 0.1))[:2]) < 0.1


@pytest.mark.parametrize("cell", [3, 9, 10, 17])
def test_a_cell_that_shows_the_opposite_is_found_out(cell: int) -> None:
    covered = BOTTOM.distance_m(SENSORS_M, TRUTH) < 0
    of_cell = slice(5 * (cell - 1), 5 * cell)
    stuck = not covered[of_cell].any()
    covered[of_cell] = stuck
    search, _ = searched(covered)
    assert search.found is not None
    assert np.hypot(*(search.found.pose - TRUTH)[:2]) < 0.02
    assert search.left_out.nonzero()[0].tolist() == list(range(5 * (cell - 1), 5 * cell))


def test_nothing_is_found_where_nothing_is_covered() -> None:
    search, steps = searched(np.zeros(len(SENSORS_M), dtype=bool))
    assert steps == 1
    assert search.found is None


@pytest.mark.parametrize("cell", range(1, 19))
def test_one_cell_that_is_all_stuck_shows_no_parcel(cell: int) -> None:
    covered = np.zeros(len(SENSORS_M), dtype=bool)
    covered[5 * (cell - 1) : 5 * cell] = True
    for footprint in (BOTTOM, Disc(0.34)):
        assert searched(covered, footprint)[0].found is None
