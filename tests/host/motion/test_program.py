from collections.abc import Mapping

import numpy as np
import pytest
from tests.host.motion.believing import beliefs
from tests.host.motion.driving import traction_of

from mdms_host.estimation.belief import Belief, BeliefKind
from mdms_host.estimation.footprint import Rectangle
from mdms_host.estimation.tracker import Parcel
from mdms_host.layout import Layout
from mdms_host.motion.contact import gap_m
from mdms_host.motion.goal import Goal
from mdms_host.motion.program import FieldProgram, GoalProgram
from mdms_model.arrays import Floats

LAYOUT = Layout(12, 3)
LEFT, RIGHT = Parcel("left", 0.36, 0.30), Parcel("right", 0.30, 0.30)
POSES = {"left": np.array([-0.4, 0.0, 0.0]), "right": np.array([0.4, 0.0, 0.3])}


def program(**goals: Goal) -> GoalProgram:
    return GoalProgram(traction_of(LAYOUT), (LEFT, RIGHT), goals)


def known(poses: Mapping[str, Floats] = POSES) -> dict[str, Belief]:
    return beliefs(poses, (LEFT, RIGHT))


def test_each_parcel_is_moved_as_a_rigid_body_of_its_own() -> None:
    references_m_s = program(left=Goal(-0.2, 0.1), right=Goal(0.2, 0.0, 0.0)).references_m_s(
        known(), 0.01
    )
    ways = {"left": (0.2, 0.1, 0.0), "right": (-0.2, 0.0, -0.3)}
    for parcel in (LEFT, RIGHT):
        way = np.array(ways[parcel.name])
        pose = POSES[parcel.name]
        footprint = Rectangle(parcel.length_m, parcel.width_m)
        under = footprint.distance_m(LAYOUT.wheel_positions_m, pose) < 0
        pushes = LAYOUT.surface_jacobian(*pose[:2])[under].T @ references_m_s[under]
        assert pushes[0] * way[0] > 0
        assert pushes[1] / pushes[0] == pytest.approx(way[1] / way[0], abs=0.02)
        assert not way[2] or pushes[2] * way[2] > 0


def test_wheels_near_no_steered_parcel_stand_still() -> None:
    references_m_s = program(left=Goal(-0.2, 0.0)).references_m_s(known(), 0.01)
    right_half = LAYOUT.wheel_positions_m[:, 0] > 0
    assert not references_m_s[right_half].any()
    assert references_m_s[~right_half].any()


def test_nothing_moves_before_its_parcel_has_been_found() -> None:
    assert not program(left=Goal(0.0, 0.0)).references_m_s({}, 0.01).any()


def test_a_program_is_finished_when_all_parcels_have_arrived() -> None:
    steered = program(left=Goal(-0.4, 0.0), right=Goal(0.2, 0.0))
    for _ in range(50):
        steered.references_m_s(known(), 0.01)
    assert not steered.finished
    for _ in range(50):
        steered.references_m_s(known({**POSES, "right": np.array([0.2, 0.0, 0.0])}), 0.01)
    assert steered.finished


def test_wheels_under_a_parcel_without_a_goal_stand_still_as_others_pass() -> None:
    poses = {"left": np.array([-0.25, 0.0, 0.0]), "right": np.array([0.09, 0.0, 0.0])}
    references_m_s = program(left=Goal(-0.25, 0.5)).references_m_s(known(poses), 0.01)
    under = Rectangle(0.30, 0.30).distance_m(LAYOUT.wheel_positions_m, poses["right"]) < 0
    assert not references_m_s[under].any()
    assert references_m_s[LAYOUT.wheel_positions_m[:, 0] < -0.1].any()


def test_wheels_stand_still_where_a_parcel_was_put_that_is_not_found_yet() -> None:
    parcels = (LEFT, Parcel("right", 0.30, 0.30, near_m=(0.09, 0.0)))
    steered = GoalProgram(traction_of(LAYOUT), parcels, {"left": Goal(0.5, 0.0)})
    references_m_s = steered.references_m_s(known({"left": np.array([-0.25, 0.0, 0.0])}), 0.01)
    under = Rectangle(0.30, 0.30).distance_m(LAYOUT.wheel_positions_m, np.array([0.09, 0, 0])) < 0
    assert not references_m_s[under].any()
    assert references_m_s.any()


def test_a_parcel_that_does_not_get_on_rests_within_a_second_and_is_stopped_after_five_tries() -> (
    None
):
    steered = program(left=Goal(0.4, 0.0))
    for _ in range(100):
        references_m_s = steered.references_m_s(known(), 0.01)
    assert steered.take_notices() == [
        "left does not get on, 800 mm from its goal: it is tried again"
    ]
    assert not references_m_s.any()
    assert steered.stuck is None
    for _ in range(800):
        references_m_s = steered.references_m_s(known(), 0.01)
    assert not references_m_s.any()
    assert not steered.finished
    stopped = "left does not get on, 800 mm from its goal, tried 5 times: stopped"
    assert steered.take_notices() == [stopped]
    assert steered.stuck == stopped


def test_a_parcel_gets_on_once_its_obstacle_is_gone() -> None:
    steered = program(left=Goal(0.4, 0.0))
    for _ in range(130):
        steered.references_m_s(known(), 0.01)
    begun = [steered.references_m_s(known(), 0.01).any() for _ in range(50)]
    assert any(begun)
    assert steered.stuck is None


def test_wheels_that_slip_under_a_parcel_are_reported_once() -> None:
    parcels = (LEFT, RIGHT)
    steered = GoalProgram(traction_of(LAYOUT, speed_m_s=0.6), parcels, {"left": Goal(0.2, 0.0)})
    x_m, speed_m_s, notices = -0.4, 0.0, []
    for step in range(60):
        twist = np.array([speed_m_s, 0.0, 0.0])
        pose = {**POSES, "left": np.array([x_m, 0.0, 0.0])}
        steered.references_m_s(beliefs(pose, parcels, twist=twist), 0.01)
        notices += steered.take_notices()
        # The wheels speed up twice as fast as they are to push the parcel to.
        speed_m_s = min(0.5, 0.018 * step)
        x_m += 0.01 * speed_m_s
    assert [text for text in notices if text.startswith("wheels slip under left: they push")]
    assert len([text for text in notices if "slip" in text]) == 1


def test_two_on_their_way_into_each_other_are_stopped_once_both_have_been_found() -> None:
    parcels = (Parcel("left", 0.36, 0.30), Parcel("right", 0.30, 0.30, near_m=(0.08, 0.0)))
    steered = GoalProgram(traction_of(LAYOUT), parcels, {"left": Goal(0.5, 0.0)})
    pose = {"left": np.array([-0.25, 0.0, 0.0])}
    for step in range(30):
        pose["left"] = pose["left"] + (0.001 if step > 20 else 0.0, 0.0, 0.0)
        assert steered.references_m_s(known(pose), 0.01).any()
    assert steered.take_notices() == []
    both = known({**pose, "right": np.array([0.08, 0.0, 0.0])})
    for _ in range(10):
        steered.references_m_s(both, 0.01)
    waits = "left and right would press each other: they wait, 5 s at most"
    assert steered.take_notices() == [waits]
    for _ in range(550):
        references_m_s = steered.references_m_s(both, 0.01)
    assert not references_m_s.any()
    assert steered.take_notices() == ["left and right press each other: stopped"]
    assert steered.stuck == "left and right press each other: stopped"


def test_a_parcel_goes_on_once_the_one_that_it_would_press_is_gone() -> None:
    steered = program(left=Goal(0.5, 0.0))
    poses = {"left": np.array([-0.25, 0.0, 0.0]), "right": np.array([0.08, 0.0, 0.0])}
    for _ in range(300):
        references_m_s = steered.references_m_s(known(poses), 0.01)
    assert not references_m_s.any()
    assert steered.stuck is None
    gone = known({**poses, "right": np.array([0.08, 0.9, 0.0])})
    assert any(steered.references_m_s(gone, 0.01).any() for _ in range(50))


def test_of_two_whose_ways_cross_one_goes_first_and_then_the_other() -> None:
    """Each is where it is steered to, as far as the wheels under it push."""
    poses = {"left": np.array([-0.34, 0.0, 0.0]), "right": np.array([0.0, -0.34, 0.0])}
    steered = program(left=Goal(0.5, 0.0), right=Goal(0.0, 0.5, 0.0))
    notices, nearest_m = [], 1.0
    for _ in range(3000):
        steered.references_m_s(known(poses), 0.01)
        notices += steered.take_notices()
        for name, one in steered.controllers.items():
            follower = one.follower
            if follower is not None and not one.paused and not one.stopped:
                poses[name] = follower.path.pose_at(follower.s_m)
        outlines = {each.name: Rectangle(each.length_m, each.width_m) for each in (LEFT, RIGHT)}
        ends = [(outlines[name], poses[name]) for name in ("left", "right")]
        nearest_m = min(nearest_m, gap_m(*ends[0], *ends[1]))
    assert notices == ["left and right would press each other: they wait, 5 s at most"]
    assert steered.finished
    assert nearest_m > 0.0


def test_a_parcel_gets_another_goal_on_its_way_and_is_taken_there() -> None:
    steered = program(left=Goal(0.4, 0.0))
    pose = POSES["left"].copy()
    for _ in range(40):
        before = steered.references_m_s(known({**POSES, "left": pose}), 0.01)
        pose[0] += 0.001
    along_x = np.abs(LAYOUT.wheel_directions[:, 0]) > 0.5
    assert before[along_x].max() > 0.01
    steered.set_goal("left", Goal(-0.8, 0.0))
    assert steered.controllers["left"].goal == Goal(-0.8, 0.0)
    for _ in range(60):
        after = steered.references_m_s(known({**POSES, "left": pose}), 0.01)
    assert after[along_x].min() < -0.01


def test_a_parcel_that_was_stopped_is_steered_again_to_a_new_goal() -> None:
    steered = program(left=Goal(0.4, 0.0))
    for _ in range(900):
        steered.references_m_s(known(), 0.01)
    assert steered.stuck
    steered.set_goal("left", Goal(-0.4, 0.2))
    assert steered.stuck is None
    assert steered.references_m_s(known(), 0.01).any()


def test_a_parcel_without_a_goal_gets_one_and_one_that_is_not_there_none() -> None:
    steered = program(left=Goal(-0.4, 0.0))
    steered.set_goal("right", Goal(0.4, 0.2))
    for _ in range(5):
        references_m_s = steered.references_m_s(known(), 0.01)
    assert references_m_s[LAYOUT.wheel_positions_m[:, 0] > 0].any()
    with pytest.raises(KeyError):
        steered.set_goal("crate", Goal(0.0, 0.0))


def lying(kind: BeliefKind) -> Belief:
    pose = np.array([0.0, 0.0, 0.0])
    return Belief("crate", Rectangle(0.3, 0.3), pose, np.zeros(3), np.zeros((3, 3)), kind=kind)


@pytest.mark.parametrize("kind", [BeliefKind.UNKNOWN, BeliefKind.HEAP])
def test_an_unnamed_thing_gets_no_goal(kind: BeliefKind) -> None:
    steered = program()
    steered.references_m_s(known() | {"crate": lying(kind)}, 0.01)
    with pytest.raises(KeyError):
        steered.set_goal("crate", Goal(0.1, 0.0))
    assert not steered.references_m_s(known() | {"crate": lying(kind)}, 0.01).any()


def test_a_named_thing_gets_a_goal_and_counts_as_a_parcel() -> None:
    steered = program(left=Goal(0.4, 0.0))
    there = known() | {"crate": lying(BeliefKind.PARCEL)}
    steered.references_m_s(there, 0.01)
    steered.set_goal("crate", Goal(0.0, 0.2))
    for _ in range(10):
        references_m_s = steered.references_m_s(there, 0.01)
    under = Rectangle(0.3, 0.3).distance_m(LAYOUT.wheel_positions_m, there["crate"].pose) < 0
    assert references_m_s[under].any()
    assert steered.take_notices() == []


def test_a_field_takes_no_goal() -> None:
    with pytest.raises(ValueError, match="steers no parcel"):
        FieldProgram(np.zeros(72)).set_goal("left", Goal(0.0, 0.0))
