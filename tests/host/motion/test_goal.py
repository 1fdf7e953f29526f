from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.host.motion.believing import beliefs
from tests.host.motion.driving import BOX, STEP_S, Table, mass_of, straight, traction_of

from mdms_host.estimation.belief import Belief, Standing
from mdms_host.motion.goal import GoalController, GoalPose
from mdms_host.motion.trajectory.follower import Carried, Follower

REACH_M = BOX.footprint.reach_m
POSE = st.tuples(st.floats(-0.15, 0.15), st.floats(-0.03, 0.03), st.floats(-3, 3)).map(np.array)


def controller_of(goal: GoalPose, speed_m_s: float = 0.1) -> GoalController:
    return GoalController(goal, traction_of(speed_m_s=speed_m_s), mass_of(BOX))


def step(controller: GoalController, pose: Any, **others: Any) -> np.ndarray:
    """The twist commanded to a parcel that is believed to be at rest there."""
    believed = beliefs({"box": np.array(pose)}, [BOX], **others)["box"]
    carried = controller.step(believed, STEP_S)
    return np.zeros(3) if carried is None else carried.twist


def drive(controller: GoalController, table: Table, seconds: float) -> np.ndarray:
    """Move a parcel on; its twists."""
    twists = []
    for _ in range(round(seconds / STEP_S)):
        table.step(controller.step)
        twists.append(table.twist)
    return np.array(twists)


@settings(max_examples=4, deadline=None)
@given(POSE)
def test_the_goal_is_reached_without_slip(start: np.ndarray) -> None:
    controller, table = controller_of(GoalPose(0.0, 0.0, 0.0), speed_m_s=0.2), Table(start)
    drive(controller, table, 5.0)
    assert controller.arrived
    assert np.hypot(*table.pose[:2]) < 0.002
    assert abs(table.pose[2]) < 0.01
    assert table.most_slip_m_s < 0.005


def test_a_doubtful_parcel_does_not_arrive() -> None:
    """Such as one that is held, which no sensor shows and nothing feels for."""
    controller = controller_of(GoalPose(0.0, 0.0, 0.0))
    for _ in range(round(2.0 / STEP_S)):
        step(controller, (0.0, 0.0, 0.0), standing=Standing.DOUBTFUL)
    assert not controller.arrived
    step(controller, (0.0, 0.0, 0.0))
    assert not controller.arrived
    for _ in range(round(2.0 / STEP_S)):
        step(controller, (0.0, 0.0, 0.0))
    assert controller.arrived


@settings(max_examples=10, deadline=None)
@given(POSE, st.floats(0.02, 0.5))
def test_no_parcel_is_commanded_to_go_faster_than_the_cap(start: np.ndarray, cap: float) -> None:
    controller, table = controller_of(GoalPose(0.0, 0.0, 0.0), speed_m_s=cap), Table(start)
    commanded = []

    def command(belief: Belief, step_s: float) -> Carried | None:
        carried = controller.step(belief, step_s)
        if carried is not None:
            commanded.append(carried.reference * (1, 1, REACH_M))
        return carried

    for _ in range(120):
        table.step(command)
    assert np.linalg.norm(commanded, axis=1).max() <= cap * (1 + 1e-9)


@pytest.mark.parametrize("friction", [0.3, 0.25])
def test_a_quarter_metre_takes_little_more_than_a_second_without_slip(friction: float) -> None:
    controller = controller_of(GoalPose(0.125, 0.0, 0.0), speed_m_s=0.7)
    table = Table(np.array([-0.125, 0.0, 0.0]), friction=friction)
    drive(controller, table, 1.05)
    assert table.pose[0] == pytest.approx(0.125, abs=0.002)
    assert table.slipping < 0.02 * table.carrying


def test_the_short_way_round_is_taken() -> None:
    assert step(controller_of(GoalPose(0.0, 0.0, 3.0)), (0.0, 0.0, -3.0))[2] < 0


def test_a_parcel_that_has_arrived_is_left_alone_until_it_is_well_away() -> None:
    controller = controller_of(GoalPose(0.0, 0.0, tolerance_m=0.002))
    drive(controller, Table(np.zeros(3)), 0.5)
    assert controller.arrived
    assert not step(controller, (0.003, 0.0, 0.0)).any()
    assert controller.arrived
    assert step(controller, (0.005, 0.0, 0.0))[0] < 0
    assert not controller.arrived


def test_no_parcel_arrives_while_sensors_are_wrong_too_often() -> None:
    controller = controller_of(GoalPose(0.0, 0.0, 0.0))
    for _ in range(200):
        step(controller, (0.0, 0.0, 0.0), noisy=True)
        assert not controller.arrived
        assert controller.settling
    for _ in range(round(0.4 / STEP_S)):
        step(controller, (0.0, 0.0, 0.0))
    assert controller.arrived
    step(controller, (0.0, 0.0, 0.0), noisy=True)
    assert controller.arrived


def test_passing_through_the_goal_is_not_arriving() -> None:
    controller = controller_of(GoalPose(0.0, 0.0, settle_s=0.3))
    for count in range(100):
        step(controller, (-0.05 + 0.001 * count, 0.0, 0.0))
        assert not controller.arrived


def test_a_parcel_that_has_arrived_is_held_until_a_sensor_contradicts() -> None:
    controller = controller_of(GoalPose(0.0, 0.0))
    drive(controller, Table(np.zeros(3)), 0.4)
    assert controller.arrived
    for _ in range(100):
        assert not step(controller, (0.01, 0.0, 0.0), corrected=False).any()
    assert step(controller, (0.01, 0.0, 0.0), corrected=True)[0] < 0
    assert not controller.arrived


def test_a_goal_without_a_yaw_turns_nothing_and_is_reached_however_the_parcel_is_turned() -> None:
    controller, table = controller_of(GoalPose(0.0, 0.0, None)), Table(np.array([0.05, 0.02, 1.3]))
    drive(controller, table, 4.0)
    assert controller.arrived
    assert table.pose[2] == pytest.approx(1.3, abs=0.002)


@pytest.mark.parametrize("yaw_rad", [0.0, None])
def test_a_parcel_whose_place_is_not_sure_turns_before_it_has_arrived_and_turns_back(
    yaw_rad: float | None,
) -> None:
    controller, table = controller_of(GoalPose(0.0, 0.0, yaw_rad)), Table(np.zeros(3))
    controller.feel = (np.array([0.0, 0.0, 0.1]),)
    most_rad = 0.0
    for _ in range(500):
        table.step(controller.step)
        most_rad = max(most_rad, float(table.pose[2]))
        if table.pose[2] > 0.08:
            controller.feel = ()
    assert most_rad > 0.08
    assert controller.arrived
    assert abs(table.pose[2]) < 0.01
    assert controller.leg == 2


def test_a_parcel_whose_place_no_turn_makes_sure_arrives_after_three() -> None:
    controller = controller_of(GoalPose(0.0, 0.0, 0.0))
    controller.feel = (np.array([0.0, 0.0, 0.05]),)
    drive(controller, Table(np.zeros(3)), 10.0)
    assert controller.arrived
    assert controller.leg == 4


def test_a_parcel_that_may_be_beside_its_goal_is_felt_for_once_more() -> None:
    """It arrived 5.6 mm off after three moves, known to 6 mm."""
    controller, table = controller_of(GoalPose(0.0, 0.0, 0.0)), Table(np.zeros(3))
    controller.feel = (np.array([0.0, 0.0, 0.05]),)
    unsure = np.diag([0.003**2, 0.001**2, 1e-6])
    for _ in range(round(12.0 / STEP_S)):
        table.step(
            lambda belief, step_s: controller.step(replace(belief, covariance=unsure), step_s)
        )
    assert controller.arrived
    # Four ways out, and one back.
    assert controller.leg == 5
    assert controller.moves == 4


def test_a_parcel_that_cannot_be_felt_any_further_goes_back_and_arrives() -> None:
    controller, table = controller_of(GoalPose(0.0, 0.0, 0.0)), Table(np.zeros(3))
    controller.feel = (np.array([0.0, 0.0, 0.1]),)
    for _ in range(500):
        table.step(controller.step)
        if table.pose[2] > 0.08:
            # It would tip over the edge of the table there.
            controller.feel = (np.array([0.0, 2.0, 0.0]),)
    assert controller.arrived
    assert abs(table.pose[2]) < 0.01


def test_a_parcel_that_would_tip_by_one_move_makes_the_next() -> None:
    controller, table = controller_of(GoalPose(0.0, 0.0, 0.0)), Table(np.zeros(3))
    controller.feel = np.array([0.0, 2.0, 0.0]), np.array([0.0, 0.0, 0.1])
    most_rad = 0.0
    for _ in range(150):
        table.step(controller.step)
        most_rad = max(most_rad, float(table.pose[2]))
    assert most_rad > 0.08
    assert abs(table.pose[1]) < 0.001


def test_a_parcel_that_is_paused_comes_to_rest_and_goes_on() -> None:
    controller, table = controller_of(GoalPose(0.2, 0.0)), Table(np.array([-0.15, 0.0, 0.0]))
    drive(controller, table, 1.0)
    controller.paused = True
    drive(controller, table, 0.6)
    assert abs(table.twist).max() < 1e-4
    controller.paused = False
    drive(controller, table, 0.3)
    assert table.twist[0] > 0.05


@pytest.mark.parametrize("cell", [8, 9])
def test_a_parcel_arrives_over_a_cell_that_is_lost_on_its_way(cell: int) -> None:
    traction = traction_of(speed_m_s=0.6)
    controller = GoalController(GoalPose(0.15, 0.02, 0.4), traction, mass_of(BOX))
    table = Table(np.array([-0.15, -0.02, 0.0]), lost=(cell,))
    drive(controller, table, 0.3)
    traction.lose({cell})
    drive(controller, table, 4.0)
    assert controller.arrived
    np.testing.assert_allclose(table.pose, (0.15, 0.02, 0.4), atol=0.004)


def test_a_parcel_that_is_set_down_beside_its_way_stops_and_takes_another_from_there() -> None:
    controller, table = controller_of(GoalPose(0.15, 0.0, 0.0)), Table(np.array([-0.15, 0.0, 0.0]))
    drive(controller, table, 1.0)
    elsewhere = Table(np.array([0.0, 0.04, 0.2]))
    drive(controller, elsewhere, 0.2)
    assert elsewhere.pose[1] > 0.03
    drive(controller, elsewhere, 5.0)
    assert controller.arrived
    np.testing.assert_allclose(elsewhere.pose, (0.15, 0.0, 0.0), atol=0.003)


def test_a_parcel_goes_on_with_the_motion_that_it_has() -> None:
    traction = traction_of(speed_m_s=0.5)
    start, end = np.array([-0.15, 0.0, 0.0]), np.array([0.15, 0.0, 0.0])
    profile = traction.profile(straight(start, end, REACH_M), BOX.footprint, mass_of(BOX))
    follower, table = Follower(traction, profile), Table(start)
    while table.pose[0] < 0.1:
        table.step(follower.step)
    controller = controller_of(GoalPose(0.15, 0.0), speed_m_s=0.5)
    controller.go_on_with(follower)
    speeds_m_s = drive(controller, table, 1.0)[:, 0]
    assert controller.arrived
    assert speeds_m_s[0] > 0.2
    assert table.pose == pytest.approx(end, abs=0.002)
