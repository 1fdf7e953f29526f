from typing import Any

import numpy as np
import pytest

from mdms_host.estimation.footprint import Disc, Footprint, Rectangle
from mdms_host.estimation.pose.feeling import moves_to_feel
from mdms_host.layout import Layout
from mdms_model.arrays import Floats

SENSORS_M = Layout(6, 3).sensor_positions_m.reshape(-1, 2)
ALL = np.ones(len(SENSORS_M), dtype=bool)
BOX = Rectangle(0.36, 0.30)
SIZE = (1e-8, 1e-8)
UNSURE_ACROSS = np.diag([1e-8, 2.5e-5, 1e-6, *SIZE])


def first_move(*given: Any) -> Floats | None:
    return next(iter(moves_to_feel(*given)), None)


def test_a_place_that_is_sure_needs_no_turn() -> None:
    assert first_move(BOX, SENSORS_M, ALL, np.zeros(3), np.eye(5) * 1e-7) is None


def test_an_edge_passes_a_sensor_in_the_turn() -> None:
    pose = np.array([0.01, 0.012, 0.0])
    turn = first_move(BOX, SENSORS_M, ALL, pose, UNSURE_ACROSS)
    assert turn is not None
    assert not turn[:2].any()
    assert passes(BOX, pose, turn)


def passes(footprint: Footprint, pose: np.ndarray, move: np.ndarray) -> bool:
    before = footprint.distance_m(SENSORS_M, pose) < 0
    return bool((before != (footprint.distance_m(SENSORS_M, pose + move) < 0)).any())


def test_a_place_that_no_turn_shows_is_felt_by_a_shift_along_its_widest_spread() -> None:
    pose = np.array([0.01, 0.012, 0.0])
    for footprint in (Disc(0.34), Rectangle(0.30, 0.25)):
        shift = first_move(footprint, SENSORS_M, ALL, pose, UNSURE_ACROSS)
        assert shift is not None
        assert shift[0] == shift[2] == 0.0
        assert passes(footprint, pose, shift)


def test_nothing_is_felt_for_with_no_sensors_or_where_a_shift_is_not_worth_it() -> None:
    pose = np.array([0.01, 0.012, 0.0])
    assert first_move(BOX, SENSORS_M, ~ALL, pose, UNSURE_ACROSS) is None
    assert first_move(Disc(0.34), SENSORS_M, ALL, pose, np.diag([1e-8, 4e-6, 1e-6, *SIZE])) is None


def test_a_turn_that_is_not_known_is_felt_where_the_place_is() -> None:
    pose, within_2_degrees = np.array([0.01, 0.012, 0.0]), np.diag([1e-7, 1e-7, 2.5e-4, *SIZE])
    turn = first_move(BOX, SENSORS_M, ALL, pose, within_2_degrees)
    assert turn is not None
    assert not turn[:2].any()
    assert passes(BOX, pose, turn)
    # Sizes that no edge shows are not felt for.
    assert first_move(Disc(0.34), SENSORS_M, ALL, pose, within_2_degrees) is None


def test_a_place_is_shifted_that_is_not_known_to_5_mm() -> None:
    pose = np.array([0.01, 0.012, 0.0])
    assert (
        first_move(Disc(0.34), SENSORS_M, ALL, pose, np.diag([1e-8, 4.4e-6, 1e-6, *SIZE]))
        is not None
    )


def test_two_edges_are_felt_one_after_the_other() -> None:
    """No edge alone tells a shift from a turn."""
    pose, unsure = np.array([0.019, -0.024, 1.02]), np.diag([8e-6, 8e-6, 2.5e-4, *SIZE])
    turn = first_move(BOX, SENSORS_M, ALL, pose, unsure)
    assert turn is not None
    assert passes(BOX, pose, turn)


def test_an_edge_of_a_side_whose_length_is_not_known_shows_no_turn() -> None:
    """The nearest edge, which is felt where the size is known, is an end of the long side."""
    pose = np.array([-0.011, -0.031, 0.0])
    turn_rad = {}
    for length_m2 in (1e-8, 2.5e-5):
        covariance = np.diag([2.5e-7, 2.5e-7, 2.5e-4, length_m2, 1e-8])
        move = first_move(BOX, SENSORS_M, ALL, pose, covariance)
        assert move is not None
        turn_rad[length_m2] = move[2]
    assert turn_rad[1e-8] == pytest.approx(0.047, abs=0.001)
    assert turn_rad[2.5e-5] == pytest.approx(0.139, abs=0.001)


def test_a_place_that_is_hardly_known_has_other_moves_and_at_last_shifts_by_half_a_cell() -> None:
    """A box was said to be there, known to 25 mm: the only move would have tipped it."""
    pose, unsure = np.array([0.01, 0.012, 0.0]), np.diag([1e-4, 4e-5, 2e-3, *SIZE])
    moves = moves_to_feel(BOX, SENSORS_M, ALL, pose, unsure)
    for axis in (0, 1):
        along = {round(float(move[axis]), 3) for move in moves if move[axis] and not move[2]}
        assert {0.032, -0.032} <= along
    ways = [move for move in moves[: -len(along)] if not np.isclose(abs(move[:2]).sum(), 0.032)]
    assert ways
    assert all(passes(BOX, pose, move) for move in ways)
    assert len({tuple(np.sign(move)) for move in ways}) > 2
    assert len(moves_to_feel(BOX, SENSORS_M, ALL, pose, UNSURE_ACROSS * 0.1)) == 1
    assert moves_to_feel(BOX, SENSORS_M, ~ALL, pose, unsure) == ()
    turned = np.diag([1e-7, 1e-7, 2e-3, *SIZE])
    assert moves_to_feel(BOX, SENSORS_M, ALL, pose, turned)
    assert moves_to_feel(Disc(0.34), SENSORS_M, ALL, pose, turned) == ()
