import numpy as np
import pytest

from mdms_host.estimation.footprint import Rectangle
from mdms_host.motion.contact import gap_m, has_room_to

BOX = Rectangle(0.30, 0.20)


def test_gap_is_that_along_the_direction_that_parts_two_outlines_best() -> None:
    at = np.array
    assert gap_m(BOX, at([0.0, 0, 0]), BOX, at([0.31, 0, 0])) == pytest.approx(0.01)
    assert gap_m(BOX, at([0.0, 0, 0]), BOX, at([0.0, 0.195, 0])) == pytest.approx(-0.005)
    assert gap_m(BOX, at([0.0, 0, 0]), BOX, at([0.26, 0, np.pi / 2])) == pytest.approx(0.01)
    turned = gap_m(BOX, at([0.0, 0, 0]), BOX, at([0.40, 0, np.pi / 4]))
    assert turned == pytest.approx(0.40 - 0.15 - 0.25 / np.sqrt(2))


@pytest.mark.parametrize(
    ("other_m", "room"),
    [((0.6, 0.0), False), ((0.3, 0.40), False), ((0.3, 0.45), True), ((1.1, 0.0), True)],
)
def test_a_parcel_has_room_where_no_other_is_near_its_way(other_m, room) -> None:
    # Corners reach 0.18 m from the centre, and 65 mm more are to be beside the way.
    places = {"a": np.zeros(3), "b": np.array([*other_m, 0.5])}
    end = np.array([0.6, 0.0, 1.0])
    assert has_room_to(end, "a", places, {"a": BOX, "b": BOX}) == room


def test_a_parcel_that_only_turns_has_room_as_far_as_it_reaches() -> None:
    places = {"a": np.zeros(3), "b": np.array([0.42, 0.0, 0.0])}
    assert not has_room_to(np.array([0.0, 0.0, 1.0]), "a", places, {"a": BOX, "b": BOX})
    places["b"][0] = 0.44
    assert has_room_to(np.array([0.0, 0.0, 1.0]), "a", places, {"a": BOX, "b": BOX})
