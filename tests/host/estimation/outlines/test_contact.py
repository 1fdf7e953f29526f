import numpy as np
import pytest

from mdms_host.estimation.footprint import Rectangle, gap_m, has_room

BOX = Rectangle(0.30, 0.20)


def test_gap_is_that_along_the_direction_that_parts_two_outlines_best() -> None:
    at = np.array
    assert gap_m(BOX, at([0.0, 0, 0]), BOX, at([0.31, 0, 0])) == pytest.approx(0.01)
    assert gap_m(BOX, at([0.0, 0, 0]), BOX, at([0.0, 0.195, 0])) == pytest.approx(-0.005)
    assert gap_m(BOX, at([0.0, 0, 0]), BOX, at([0.26, 0, np.pi / 2])) == pytest.approx(0.01)
    turned = gap_m(BOX, at([0.0, 0, 0]), BOX, at([0.40, 0, np.pi / 4]))
    assert turned == pytest.approx(0.40 - 0.15 - 0.25 / np.sqrt(2))


def test_a_parcel_has_room_to_turn_as_far_as_it_reaches() -> None:
    # Corners reach 0.18 m from either centre, and 15 mm are to be between them.
    places = {"a": np.zeros(3), "b": np.array([0.37, 0.0, 0.0])}
    turn, move = np.array([0.0, 0.0, 1.0]), np.array([0.01, 0.0, 0.0])
    assert not has_room("a", turn, places, {"a": BOX, "b": BOX})
    places["b"][0] = 0.38
    assert has_room("a", turn, places, {"a": BOX, "b": BOX})
    assert not has_room("a", move, places, {"a": BOX, "b": BOX})


def test_a_parcel_beside_another_has_room_to_be_shifted_away_from_it() -> None:
    places = {"a": np.zeros(3), "b": np.array([0.31, 0.05, 0.0])}
    both = {"a": BOX, "b": BOX}
    away, along, round_it = np.array([(-0.03, 0.0, 0.0), (0.0, 0.03, 0.0), (-0.3, 0.3, 0.0)])
    assert has_room("a", away, places, both)
    assert has_room("a", along, places, both)
    assert not has_room("a", -away, places, both)
    assert not has_room("a", np.array([-0.03, 0.0, 0.1]), places, both)
    # A third one beyond.
    places["c"] = np.array([-0.32, 0.0, 0.0])
    both["c"] = BOX
    assert not has_room("a", away, places, both)
    assert not has_room("a", round_it, places, both)
