"""A wheel or parcel that does not move as commanded is reported soon, once, and by name."""

import numpy as np
import pytest
from tests.host.motion.believing import beliefs
from tests.host.programs.goals import program_to

from mdms_host.coordination.control_cycle import Following, Watch
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.run_state import Phase
from mdms_host.estimation.footprint import Rectangle
from mdms_host.estimation.tracker import Parcel
from mdms_host.layout import Layout, WheelPlace
from mdms_host.motion.goal import GoalPose
from mdms_host.motion.program import FieldProgram

LAYOUT = Layout(6, 3, wheels=(WheelPlace(0.0, (0.0, 0.03)), WheelPlace(np.pi / 2, (0.03, 0.0))))
BOX = Parcel("box", 0.36, 0.30)
BOTTOM = Rectangle(0.36, 0.30)
STEP_S = 0.01


@pytest.fixture
def array(rolling_array):
    return rolling_array(LAYOUT, BOTTOM, (0.0, 0.0, 0.0))


def carrying() -> Coordinator:
    return Coordinator(LAYOUT, program_to(GoalPose(0.1, 0.0, 0.3), BOX, LAYOUT), parcels=(BOX,))


def start(array, coordinator: Coordinator) -> float:
    array.run(coordinator, 2.0, lambda: coordinator.phase == Phase.RUNNING)
    assert coordinator.phase == Phase.RUNNING
    return array.now_s


def test_wheel_that_stands_under_its_reference_is_named_within_half_a_second(array) -> None:
    coordinator = Coordinator(LAYOUT, FieldProgram(np.full(36, 0.05)))
    started_s = start(array, coordinator)
    told_um_s = array._told_um_s
    array._told_um_s = lambda: [
        [speeds[0], 0] if cell == 6 else speeds for cell, speeds in enumerate(told_um_s())
    ]
    array.run(coordinator, started_s + 2.0)
    ((time_s, text),) = coordinator.troubles
    assert time_s - started_s < 0.5
    what = "does not follow: it stands, commanded to run at 50 mm/s"
    assert text.startswith(f"cell 7 (node 7) axis 2 {what}")
    assert (time_s, text) in coordinator.events


def test_parcel_that_is_not_there_is_reported_within_two_seconds(array) -> None:
    coordinator = carrying()
    array.presence = lambda: np.zeros(18, dtype=int)
    started_s = start(array, coordinator)
    array.run(coordinator, started_s + 3.0)
    ((time_s, text),) = coordinator.troubles
    assert time_s - started_s < 2.0
    assert text.startswith("box has not been found")


def test_parcel_that_stands_is_reported_within_two_seconds(array) -> None:
    coordinator = carrying()
    started_s = start(array, coordinator)
    array._move = lambda: None
    array.run(coordinator, started_s + 3.0)
    (standstill,) = [each for each in coordinator.troubles if "does not get on" in each[1]]
    assert standstill[0] - started_s < 2.0
    assert standstill[1].startswith("box does not get on, ")


def test_parcel_that_gets_there_is_no_trouble_and_its_arrival_is_noted(array) -> None:
    coordinator = carrying()
    start(array, coordinator)
    array.run(coordinator, 10.0, lambda: coordinator.finished)
    assert coordinator.troubles == []
    assert coordinator.events[-1][1] == "box has arrived"
    assert coordinator.arrived_s == {"box": coordinator.events[-1][0]}


def test_wheel_is_reported_again_only_after_it_has_turned() -> None:
    following, reference, still = Following(1), np.array([0.05]), np.zeros(1)

    def reports(speed, steps):
        return sum(len(following.step(reference, speed, STEP_S)) for _ in range(steps))

    assert reports(still, 29) == 0
    assert reports(still, 200) == 1
    assert reports(np.array([0.04]), 1) == 0
    assert reports(still, 200) == 1


def test_wheel_with_no_or_a_small_reference_may_stand() -> None:
    following = Following(2)
    for _ in range(200):
        assert following.step(np.array([0.0, 0.005]), np.zeros(2), STEP_S) == []


@pytest.mark.parametrize(
    ("deviations", "first"),
    [
        ((0.002, 0.001, 0.015), []),
        ((0.003, 0.001, 0.015), ["box is known to 7.4 mm and 1.7 degrees: no move"]),
        ((0.002, 0.001, 0.03), ["box is known to 4.9 mm and 3.4 degrees: no move"]),
    ],
)
def test_an_arrival_says_where_the_place_is_not_known_to_5_mm_and_2_degrees(
    deviations, first
) -> None:
    watch = Watch((), 2, {"box": There()})
    *doubts, arrival = watch.arrivals(known_to(deviations), 1.0)
    assert arrival == ("box has arrived", False)
    assert [(text.partition(" shows")[0], False) for text in first] == [
        (text.partition(" shows")[0], trouble) for text, trouble in doubts
    ]
    assert [*watch.arrivals(known_to(deviations), 2.0)] == []
    # It stays so though its place gets less sure.
    assert [*watch.arrivals(known_to((0.006, 0.001, 0.015)), 3.0)] == []


@pytest.mark.parametrize(
    ("deviations", "known"),
    [((0.005, 0.001, 0.015), "12.2 mm and 1.7"), ((0.002, 0.001, 0.04), "4.9 mm and 4.5")],
)
def test_no_parcel_has_arrived_whose_place_is_not_known_to_10_mm_and_4_degrees(
    deviations, known
) -> None:
    there = There()
    watch = Watch((), 2, {"box": there})
    unsure = f"box may be beside its goal: it is known to {known} degrees: no move shows its place"
    ((text, trouble),) = watch.arrivals(known_to(deviations), 1.0)
    assert (text.removesuffix(" better"), trouble) == (unsure, True)
    assert [*watch.arrivals(known_to(deviations), 2.0)] == []
    assert (watch.arrived_s, watch.unsure) == ({}, {"box": text})
    # It moves again, and comes there once more.
    there.arrived = False
    assert [*watch.arrivals(known_to(deviations), 2.0)] == []
    assert watch.unsure == {}
    there.arrived = True
    assert len([*watch.arrivals(known_to(deviations), 2.5)]) == 1
    # An edge that passes later makes it sure.
    assert [*watch.arrivals(known_to((0.002, 0.001, 0.015)), 3.0)] == [("box has arrived", False)]
    assert (watch.arrived_s, watch.unsure) == ({"box": 3.0}, {})


def test_a_parcel_that_is_steered_no_more_is_beside_no_goal() -> None:
    """It was taken off, or has left."""
    steered = {"box": There()}
    watch = Watch((), 2, steered)
    assert len([*watch.arrivals(known_to((0.005, 0.001, 0.015)), 1.0)]) == 1
    del steered["box"]
    assert [*watch.arrivals({}, 2.0)] == []
    assert watch.unsure == {}


def known_to(deviations):
    """A box at its goal, whose place has these standard deviations [m, m, rad]."""
    covariance = np.diag(np.square(deviations))
    return beliefs({"box": np.zeros(3)}, [BOX], covariance=covariance)


class There:
    """A parcel that is at its goal."""

    goal = GoalPose(0.0, 0.0, 0.0)
    arrived = True
