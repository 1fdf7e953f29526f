import numpy as np
import pytest
from tests.host.motion.driving import BOX as LARGE
from tests.host.motion.driving import Table, mass_of, traction_of

from mdms_host.layout import Layout, WheelPlace
from mdms_host.motion.footholds import MARGIN_M
from mdms_host.motion.goal import GoalController, GoalPose
from mdms_host.motion.safe_goals import SupportedParcel, least_footing, straight_way
from mdms_model.outline import outline_of
from mdms_model.scenario.scenario import Parcel

WHEELS = (WheelPlace(0.0, (-0.03, 0.0)), WheelPlace(np.pi / 2, (0.03, 0.0)))
WHEEL_M = Layout(6, 3, wheels=WHEELS).wheel_positions_m
BOX = SupportedParcel(outline_of(Parcel("box", 2.0, 0.25, 0.20)), (0.0, 0.0))


@pytest.mark.parametrize(
    "goal", [GoalPose(0.1, 0.05, 3.0), GoalPose(-0.2, 0.0, None), GoalPose(0.0, 0.0, -3.0)]
)
def test_the_way_is_the_one_that_the_controller_takes_where_nothing_tips(goal: GoalPose) -> None:
    start = np.array([-0.1, 0.0, -1.0])
    way = straight_way(start, goal, 0.2)
    controller = GoalController(goal, traction_of(), mass_of(LARGE))
    table = Table(start, LARGE)
    for _ in range(1500):
        table.step(controller.step)
        pose = table.pose
        if controller.arrived:
            break
        assert np.abs((way - pose) * (1.0, 1.0, 0.2)).max(axis=1).min() < 0.003
    assert controller.arrived


def test_a_way_ends_at_its_start_and_goal() -> None:
    way = straight_way(np.array([-0.1, 0.0, 0.0]), GoalPose(0.1, 0.05, 0.5), 0.2)
    np.testing.assert_allclose(way[[0, -1]], [[-0.1, 0.0, 0.0], [0.1, 0.05, 0.5]], atol=1e-12)
    np.testing.assert_array_equal(straight_way(way[0], None, 0.2), way[:1])


@pytest.mark.parametrize(
    ("start_y_m", "goal_y_m", "place", "margin_m"),
    [
        (0.0, 0.065, "at its start", 0.0),
        (0.065, 0.0, "at its goal", 0.0),
        (-0.065, 0.065, "on its way", -0.027),
        (0.065, 0.4, "at its goal", -np.inf),
    ],
)
def test_the_worst_place_is_named(
    start_y_m: float, goal_y_m: float, place: str, margin_m: float
) -> None:
    start = np.array([-0.1905, start_y_m, 0.0])
    footing = least_footing(WHEEL_M, BOX, start, GoalPose(-0.1905, goal_y_m))
    assert footing.place == place
    assert footing.margin_m == pytest.approx(margin_m, abs=0.002)


def test_a_wheel_at_the_very_edge_does_not_count_as_a_support() -> None:
    for y_m, stands in ((0.028, False), (0.030, True)):
        footing = least_footing(WHEEL_M, BOX, np.array([-0.1905, y_m, 0.0]), None)
        assert (footing.margin_m > MARGIN_M) == stands


def test_a_parcel_that_stays_between_two_rows_is_safe() -> None:
    footing = least_footing(WHEEL_M, BOX, np.array([-0.1905, 0.06, 0.0]), GoalPose(-0.1905, 0.067))
    assert footing.margin_m > MARGIN_M
