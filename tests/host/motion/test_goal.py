import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from mdms_host.motion.goal import Goal, GoalController, Limits

LIMITS = Limits(speed_m_s=0.1, friction=0.3, friction_share=0.15)
REACH_M = 0.23
STEP_S = 0.01
POSE = st.tuples(st.floats(-0.4, 0.4), st.floats(-0.2, 0.2), st.floats(-3, 3)).map(np.array)


def drive(controller: GoalController, pose: np.ndarray, seconds: float) -> tuple[list, np.ndarray]:
    """Twists commanded to a parcel that follows at once, and where it ends."""
    twists = []
    for _ in range(round(seconds / STEP_S)):
        twists.append(controller.step(pose, STEP_S))
        pose = pose + twists[-1] * STEP_S
    return twists, pose


@settings(max_examples=30, deadline=None)
@given(POSE)
def test_the_goal_is_reached_within_speed_and_acceleration(start: np.ndarray) -> None:
    controller = GoalController(Goal(0.0, 0.0, 0.0), LIMITS, REACH_M)
    twists, end = drive(controller, start, 20.0)
    assert controller.arrived
    assert np.hypot(*end[:2]) < 0.005
    assert abs(end[2]) < 0.02
    scaled_m_s = np.array([np.zeros(3), *twists]) * (1, 1, REACH_M)
    assert np.linalg.norm(scaled_m_s, axis=1).max() <= 0.1 + 1e-12
    change_m_s2 = np.linalg.norm(np.diff(scaled_m_s, axis=0), axis=1) / STEP_S
    assert change_m_s2.max() <= LIMITS.acceleration_m_s2 + 1e-9


def test_the_acceleration_is_a_share_of_what_friction_gives() -> None:
    assert np.isclose(LIMITS.acceleration_m_s2, 0.15 * 0.3 * 9.81)


def test_the_short_way_round_is_taken() -> None:
    controller = GoalController(Goal(0.0, 0.0, 3.0), LIMITS, REACH_M)
    assert controller.step(np.array([0.0, 0.0, -3.0]), STEP_S)[2] < 0


def test_a_parcel_that_has_arrived_is_left_alone_until_it_is_well_away() -> None:
    goal = Goal(0.0, 0.0, tolerance_m=0.002)
    controller = GoalController(goal, LIMITS, REACH_M)
    drive(controller, np.zeros(3), 0.5)
    assert controller.arrived
    np.testing.assert_array_equal(controller.step(np.array([0.003, 0.0, 0.0]), STEP_S), np.zeros(3))
    assert controller.arrived
    assert controller.step(np.array([0.005, 0.0, 0.0]), STEP_S)[0] < 0
    assert not controller.arrived


def test_passing_through_the_goal_is_not_arriving() -> None:
    controller = GoalController(Goal(0.0, 0.0, settle_s=0.3), LIMITS, REACH_M)
    for step in range(100):
        controller.step(np.array([-0.05 + 0.001 * step, 0.0, 0.0]), STEP_S)
        assert not controller.arrived


def test_a_parcel_that_has_arrived_is_held_until_a_sensor_contradicts() -> None:
    controller = GoalController(Goal(0.0, 0.0), Limits(), 0.2)
    for _ in range(40):
        controller.step(np.zeros(3), 0.01)
    assert controller.arrived
    for _ in range(100):
        assert not controller.step(np.array([0.01, 0.0, 0.0]), 0.01, contradicted=False).any()
    assert controller.step(np.array([0.01, 0.0, 0.0]), 0.01, contradicted=True)[0] < 0
    assert not controller.arrived


def test_a_parcel_that_is_stopped_brakes_and_is_not_steered_any_more() -> None:
    controller = GoalController(Goal(1.0, 0.0), Limits(), 0.2)
    for _ in range(50):
        controller.step(np.zeros(3), 0.01)
    controller.stop()
    assert controller.step(np.zeros(3), 0.01)[0] > 0.09
    for _ in range(50):
        controller.step(np.zeros(3), 0.01)
    assert not controller.step(np.zeros(3), 0.01).any()


def test_a_goal_without_a_yaw_turns_nothing_and_is_reached_however_the_parcel_is_turned() -> None:
    controller = GoalController(Goal(0.0, 0.0, None), LIMITS, REACH_M)
    twists, _ = drive(controller, np.array([0.05, 0.02, 1.3]), 5.0)
    assert controller.arrived
    assert not np.array(twists)[:, 2].any()


def test_a_parcel_whose_place_is_not_sure_turns_before_it_has_arrived_and_turns_back() -> None:
    controller = GoalController(Goal(0.0, 0.0, 0.0), LIMITS, REACH_M)
    pose, most_rad = np.zeros(3), 0.0
    controller.feel_rad = 0.1
    for _ in range(600):
        pose = pose + controller.step(pose, 0.01) * 0.01
        most_rad = max(most_rad, float(pose[2]))
        if pose[2] > 0.08:
            controller.feel_rad = None
    assert most_rad > 0.08
    assert controller.arrived
    assert abs(pose[2]) < 0.01
    assert controller.leg == 2


def test_a_parcel_whose_place_no_turn_makes_sure_arrives_after_three() -> None:
    controller, pose = GoalController(Goal(0.0, 0.0, 0.0), LIMITS, REACH_M), np.zeros(3)
    controller.feel_rad = 0.05
    for _ in range(2000):
        pose = pose + controller.step(pose, 0.01) * 0.01
    assert controller.arrived
    assert controller.leg == 4


def test_a_parcel_that_is_paused_comes_to_rest_and_goes_on() -> None:
    controller, pose = GoalController(Goal(1.0, 0.0), LIMITS, REACH_M), np.zeros(3)
    for _ in range(100):
        controller.step(pose, 0.01)
    controller.paused = True
    for _ in range(100):
        twist = controller.step(pose, 0.01)
    assert not twist.any()
    controller.paused = False
    assert controller.step(pose, 0.01)[0] > 0
