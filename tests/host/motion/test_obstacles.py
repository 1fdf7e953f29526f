"""A parcel keeps clear of objects that are no parcel of a program, and waits for them."""

import numpy as np
import pytest
from tests.host.motion.believing import beliefs
from tests.host.motion.driving import Table, traction_of

from mdms_host.estimation.belief import Belief, BeliefKind
from mdms_host.estimation.footprint import Rectangle
from mdms_host.estimation.tracker import Parcel
from mdms_host.layout import Layout, WheelPlace
from mdms_host.motion.contact import Obstacles
from mdms_host.motion.goal import Goal
from mdms_host.motion.program import GoalProgram
from mdms_host.motion.trajectory.path import Path, straight

LAYOUT = Layout(9, 3, wheels=(WheelPlace(0.0, (-0.03, 0.0)), WheelPlace(np.pi / 2, (0.03, 0.0))))
BOX = Parcel("box", 0.30, 0.26)
THING = Rectangle(0.2, 0.2)


def thing(x_m: float, y_m: float = 0.0) -> Belief:
    pose = np.array([x_m, y_m, 0.0])
    return Belief("unknown-1", THING, pose, np.zeros(3), np.zeros((3, 3)), kind=BeliefKind.UNKNOWN)


def box(x_m: float) -> Belief:
    return beliefs({"box": np.array([x_m, 0.0, 0.0])}, (BOX,))["box"]


def way_to(*end: float) -> Path:
    return straight(np.zeros(3), np.array(end), BOX.footprint.reach_m)


@pytest.mark.parametrize(
    ("end", "waits"),
    [
        ((0.4, 0.0, 0.0), True),
        ((-0.4, 0.0, 0.0), False),
        ((0.0, 0.1, 0.0), False),
        ((0.0, 0.0, 0.8), True),
    ],
)
def test_a_parcel_waits_only_where_it_would_come_nearer(
    end: tuple[float, float, float], waits: bool
) -> None:
    obstacles = Obstacles()
    obstacles.see({"box": box(0.0), "unknown-1": thing(0.265)}, {"box": None})
    assert obstacles.hold(box(0.0), way_to(*end), 0.0) is waits


def test_a_parcel_goes_on_past_things_beside_its_way_and_its_goal() -> None:
    obstacles = Obstacles()
    obstacles.see({"unknown-1": thing(0.265)}, {"box": None})
    corners = np.array([(0.0, 0.0, 0.0), (0.0, 0.3, 0.0), (0.4, 0.3, 0.0), (0.6, 0.0, 0.0)])
    assert not obstacles.hold(box(0.0), Path(corners, BOX.footprint.reach_m), 0.0)


def test_waiting_is_reported_once_and_ends_when_the_way_is_free() -> None:
    obstacles, way = Obstacles(), way_to(0.4, 0.0, 0.0)
    obstacles.see({"unknown-1": thing(0.27)}, {"box": None})
    assert obstacles.hold(box(0.0), way, 0.0)
    assert obstacles.hold(box(0.0), way, 0.0)
    assert obstacles.take_notices() == ["box waits: unknown-1 is in its way"]
    obstacles.see({}, {"box": None})
    assert not obstacles.hold(box(0.0), way, 0.0)
    assert obstacles.take_notices() == []


def test_a_program_stops_before_an_unknown_thing_and_goes_on_when_it_is_gone() -> None:
    program = GoalProgram(traction_of(LAYOUT), (BOX,), {"box": Goal(0.3, 0.0)})
    table, there = Table(np.array([-0.35, 0.0, 0.0]), BOX, LAYOUT), thing(0.1)
    under = THING.distance_m(LAYOUT.wheel_positions_m, there.pose) < 0
    for step in range(1200):
        believed = {"box": table.belief()}
        if step < 500:
            believed["unknown-1"] = there
        references_m_s = program.references_m_s(believed, 0.01)
        table.move(references_m_s)
        if step < 500:
            assert not references_m_s[under].any()
        if step == 499:
            assert -0.10 < table.pose[0] + 0.15 < 0.0 - 0.005
            assert not references_m_s.any()
    assert program.finished
    assert program.take_notices() == ["box waits: unknown-1 is in its way"]


def test_wheels_under_an_unknown_thing_stand_though_a_parcel_is_about_to_use_them() -> None:
    program = GoalProgram(traction_of(LAYOUT), (BOX,), {"box": Goal(-0.3, 0.0)})
    there = thing(0.22, 0.12)
    references_m_s = program.references_m_s({"box": box(0.0), "unknown-1": there}, 0.01)
    under = THING.distance_m(LAYOUT.wheel_positions_m, there.pose) < 0
    assert references_m_s.any()
    assert not references_m_s[under].any()
