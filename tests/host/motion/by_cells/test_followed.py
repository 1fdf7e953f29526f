from typing import Any

import numpy as np
from tests.host.motion.believing import beliefs
from tests.host.motion.driving import LAYOUT

from mdms_host.estimation.belief import Belief
from mdms_host.estimation.tracker import Parcel
from mdms_host.motion.by_cells.followed import LastLeg
from mdms_host.motion.footholds import Footholds
from mdms_host.motion.goal import GoalPose

BOX = Parcel("box", 0.36, 0.30)
GOAL = GoalPose(-0.08, -0.026, -0.8)
AT_GOAL = (GOAL.x_m, GOAL.y_m, -0.8)


def last_leg() -> LastLeg:
    return LastLeg(GOAL, Footholds(LAYOUT, BOX.footprint, (0.0, 0.0)))


def at(*pose: float, parcel: Parcel = BOX, **others: Any) -> Belief:
    return beliefs({"box": np.array(pose)}, [parcel], **others)["box"]


def test_a_box_is_taken_to_its_goal_and_is_there_where_its_place_is_sure() -> None:
    box = last_leg()
    assert not box.step(at(0.14, -0.008, 0.3), reported=False, there=False)
    assert box.places == (GOAL,)
    assert not box.step(at(0.14, 0.0, 0.2), reported=False, there=False)
    assert box.places == (GOAL,)
    assert not box.step(at(0.13, 0.0, 0.1, noisy=True), reported=True, there=True)
    assert box.step(at(0.13, 0.0, 0.1), reported=True, there=True)


def test_a_box_that_is_elsewhere_at_once_is_taken_to_its_goal_from_there() -> None:
    """It was never where it was believed, and the place where it was to be felt is none."""
    box, unsure = last_leg(), at(*AT_GOAL, feel=(np.array([0.0, 0.0, 0.2]),))
    box.step(unsure, reported=True, there=True)
    assert box.felt
    elsewhere = at(0.14, -0.008, 0.3, feel=(np.array([0.0, 0.0, 0.2]),))
    box.step(elsewhere, reported=False, there=False)
    assert box.places == (GOAL,)


def test_a_box_has_not_arrived_before_a_turn_has_made_its_place_sure() -> None:
    box, unsure = last_leg(), at(*AT_GOAL, feel=(np.array([0.0, 0.0, 0.2]),))
    box.step(unsure, reported=False, there=False)
    assert not box.step(unsure, reported=True, there=True)
    turned, goal = box.places
    assert (turned.x_m, turned.y_m, turned.yaw_rad) == (GOAL.x_m, GOAL.y_m, -0.8 + 0.2)
    # As soon as an edge has shown it, it turns back.
    assert not box.step(at(-0.08, -0.026, -0.7), reported=False, there=False)
    assert box.places == (goal,)
    assert box.step(at(*AT_GOAL), reported=True, there=True)


def test_an_edge_decides_where_cells_report_a_box_at_its_goal_and_the_host_is_not_sure() -> None:
    box, unsure = last_leg(), at(*AT_GOAL, feel=(np.array([0.0, 0.0, 0.2]),))
    box.step(unsure, reported=False, there=False)
    assert not box.step(unsure, reported=True, there=False)
    assert len(box.places) == 2


def test_a_box_that_no_turn_makes_sure_has_arrived_after_three() -> None:
    box, unsure = last_leg(), at(*AT_GOAL, feel=(np.array([0.0, 0.0, 0.2]),))
    turns = 0
    for _ in range(20):
        arrived = box.step(unsure, reported=True, there=True)
        turns += len(box.places) == 2
    assert arrived
    assert turns == 3


def test_a_box_that_may_be_beside_its_goal_is_moved_once_more() -> None:
    unsure = at(*AT_GOAL, feel=(np.array([0.0, 0.0, 0.2]),), covariance=np.diag([9e-6, 1e-6, 1e-6]))
    box, turns = last_leg(), 0
    for _ in range(50):
        arrived = box.step(unsure, reported=True, there=True)
        turns += len(box.places) == 2
    assert arrived
    assert turns == 4


def test_a_box_is_at_its_goal_again_where_cells_have_gone_back_by_themselves() -> None:
    box = last_leg()
    box.step(at(*AT_GOAL, feel=(np.array([0.0, 0.0, 0.2]),)), reported=True, there=True)
    assert box.felt
    box.overtaken()
    assert box.places == (GOAL,)
