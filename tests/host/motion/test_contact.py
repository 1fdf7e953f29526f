import numpy as np
import pytest

from mdms_host.estimation.footprint import Rectangle
from mdms_host.motion.contact import Contacts, MovingBody, gap_m, has_room_to
from mdms_host.motion.trajectory.path import straight

BOX = Rectangle(0.30, 0.20)
STEP_S = 0.01


def body(
    x_m: float, y_m: float = 0.0, speed_m_s: float = 0.0, aside_m_s: float = 0.0
) -> MovingBody:
    return MovingBody(BOX, np.array([x_m, y_m, 0.0]), np.array([speed_m_s, aside_m_s, 0.0]), 0.2)


def pairs(one: MovingBody, other: MovingBody, steps: int = 10) -> list[tuple[str, str]]:
    contacts = Contacts()
    return [p for _ in range(steps) for p in contacts.step({"a": one, "b": other}, STEP_S)]


def test_gap_is_that_along_the_direction_that_parts_two_outlines_best() -> None:
    at = np.array
    assert gap_m(BOX, at([0.0, 0, 0]), BOX, at([0.31, 0, 0])) == pytest.approx(0.01)
    assert gap_m(BOX, at([0.0, 0, 0]), BOX, at([0.0, 0.195, 0])) == pytest.approx(-0.005)
    assert gap_m(BOX, at([0.0, 0, 0]), BOX, at([0.26, 0, np.pi / 2])) == pytest.approx(0.01)
    turned = gap_m(BOX, at([0.0, 0, 0]), BOX, at([0.40, 0, np.pi / 4]))
    assert turned == pytest.approx(0.40 - 0.15 - 0.25 / np.sqrt(2))


def test_a_parcel_on_its_way_into_another_is_reported() -> None:
    assert ("a", "b") in pairs(body(0.0, speed_m_s=0.1), body(0.304))


def test_a_parcel_that_can_still_stop_is_not_reported() -> None:
    assert pairs(body(0.0, speed_m_s=0.1), body(0.32)) == []


def on_its_way(x_m: float, to_x_m: float, speed_m_s: float) -> MovingBody:
    way = straight(np.array([x_m, 0.0, 0.0]), np.array([to_x_m, 0.0, 0.0]), BOX.reach_m)
    return MovingBody(BOX, way.start, np.array([speed_m_s, 0.0, 0.0]), 0.2, way)


def test_a_parcel_on_its_way_is_reported_before_it_is_too_late() -> None:
    # It stops within 10 mm as planned, within 13 mm at worst, and 20 mm are for the belief.
    other = body(0.327)
    assert ("a", "b") in pairs(on_its_way(0.0, 0.5, 0.1), other)
    assert pairs(on_its_way(-0.01, 0.5, 0.1), other) == []
    # Two that go towards each other look ahead each.
    assert ("a", "b") in pairs(on_its_way(0.0, 0.5, 0.1), on_its_way(0.354, 0.0, -0.1))
    # It need not have begun to move.
    assert ("a", "b") in pairs(on_its_way(0.0, 0.5, 0.0), body(0.304))


def test_a_parcel_may_be_taken_close_to_another() -> None:
    assert pairs(on_its_way(0.0, 0.01, 0.05), body(0.312)) == []


def test_a_parcel_behind_another_that_goes_on_as_fast_is_not_reported() -> None:
    assert pairs(on_its_way(0.0, 0.5, 0.1), on_its_way(0.31, 0.8, 0.1)) == []


def test_a_parcel_that_passes_by_is_not_reported() -> None:
    assert pairs(body(0.0, speed_m_s=0.1), body(0.1, 0.199)) == []
    assert pairs(body(0.0, speed_m_s=-0.1), body(0.29)) == []


def test_a_parcel_that_passes_by_is_not_reported_for_beliefs_that_overlap_a_little() -> None:
    assert pairs(body(0.0, speed_m_s=0.1, aside_m_s=0.01), body(0.1, 0.19)) == []
    assert ("a", "b") in pairs(body(0.0, speed_m_s=0.1, aside_m_s=0.01), body(0.1, 0.175))


def test_parcels_that_stand_may_touch() -> None:
    assert pairs(body(0.0), body(0.29)) == []


def test_a_state_of_a_moment_is_not_reported() -> None:
    assert pairs(body(0.0, speed_m_s=0.1), body(0.304), steps=3) == []


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
