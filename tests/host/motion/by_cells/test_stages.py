from dataclasses import replace
from typing import Any

import numpy as np
from tests.host.motion.believing import beliefs
from tests.host.motion.driving import LAYOUT

from mdms_host.estimation.belief import Belief
from mdms_host.estimation.tracker import Parcel
from mdms_host.motion.by_cells.stages import Stages
from mdms_host.motion.footholds import Footholds
from mdms_host.motion.goal import Goal

BOX, SMALL = Parcel("box", 0.36, 0.30), Parcel("box", 0.28, 0.22)
GOAL = Goal(-0.08, -0.026, -0.8)
AT_GOAL = (GOAL.x_m, GOAL.y_m, -0.8)


def stages(parcel: Parcel = BOX) -> Stages:
    return Stages(GOAL, Footholds(LAYOUT, parcel.footprint, (0.0, 0.0)))


def at(*pose: float, parcel: Parcel = BOX, **others: Any) -> Belief:
    return beliefs({"box": np.array(pose)}, [parcel], **others)["box"]


def goes(box: Stages, start: Belief, end: Belief) -> None:
    """It is believed ever nearer to the end, as it moves there."""
    for share in np.linspace(0.0, 1.0, 20):
        pose = start.pose + share * (end.pose - start.pose)
        box.step(replace(end, pose=pose), reported=False, there=False)


def test_a_box_that_tips_nowhere_is_taken_straight_to_its_goal() -> None:
    box = stages()
    assert not box.step(at(0.14, -0.008, 0.3), reported=False, there=False)
    assert box.places == (GOAL,)
    assert not box.step(at(0.14, 0.0, 0.2), reported=False, there=False)
    assert box.places == (GOAL,)
    assert not box.step(at(0.13, 0.0, 0.1, noisy=True), reported=True, there=True)
    assert box.step(at(0.13, 0.0, 0.1), reported=True, there=True)


def test_a_box_that_would_tip_is_taken_around_corner_by_corner() -> None:
    box, start = stages(SMALL), at(0.14, -0.008, 0.3, parcel=SMALL)
    while not box.places:
        assert not box.step(start, reported=True, there=True)
    corner, goal = box.places
    assert goal == GOAL
    assert not box.step(start, reported=False, there=False)
    assert box.places == (corner, goal)
    assert corner.yaw_rad is not None
    goes(box, start, at(corner.x_m, corner.y_m + 0.005, corner.yaw_rad, parcel=SMALL))
    assert box.places == (goal,)


def test_a_box_that_is_elsewhere_at_once_is_taken_on_from_there() -> None:
    """It was never where it was believed, and the corner on the way from there is no place."""
    box, start = stages(SMALL), at(0.14, -0.008, 0.3, parcel=SMALL)
    while not box.places:
        box.step(start, reported=False, there=False)
    assert len(box.places) == 2
    elsewhere = at(*AT_GOAL, parcel=SMALL)
    box.step(elsewhere, reported=False, there=False)
    while not box.places:
        box.step(elsewhere, reported=False, there=False)
    assert box.places == (GOAL,)


def test_a_box_has_not_arrived_before_a_turn_has_made_its_place_sure() -> None:
    box, unsure = stages(), at(*AT_GOAL, feel=(np.array([0.0, 0.0, 0.2]),))
    box.step(unsure, reported=False, there=False)
    assert not box.step(unsure, reported=True, there=True)
    turned, goal = box.places
    assert (turned.x_m, turned.y_m, turned.yaw_rad) == (GOAL.x_m, GOAL.y_m, -0.8 + 0.2)
    # As soon as an edge has shown it, it turns back.
    assert not box.step(at(-0.08, -0.026, -0.7), reported=False, there=False)
    assert box.places == (goal,)
    assert box.step(at(*AT_GOAL), reported=True, there=True)


def test_an_edge_decides_where_cells_report_a_box_at_its_goal_and_the_host_is_not_sure() -> None:
    box, unsure = stages(), at(*AT_GOAL, feel=(np.array([0.0, 0.0, 0.2]),))
    box.step(unsure, reported=False, there=False)
    assert not box.step(unsure, reported=True, there=False)
    assert len(box.places) == 2


def test_a_box_that_no_turn_makes_sure_has_arrived_after_three() -> None:
    box, unsure = stages(), at(*AT_GOAL, feel=(np.array([0.0, 0.0, 0.2]),))
    turns = 0
    for _ in range(20):
        arrived = box.step(unsure, reported=True, there=True)
        turns += len(box.places) == 2
    assert arrived
    assert turns == 3


def test_a_box_that_may_be_beside_its_goal_is_moved_once_more() -> None:
    unsure = at(*AT_GOAL, feel=(np.array([0.0, 0.0, 0.2]),), covariance=np.diag([9e-6, 1e-6, 1e-6]))
    box, turns = stages(), 0
    for _ in range(50):
        arrived = box.step(unsure, reported=True, there=True)
        turns += len(box.places) == 2
    assert arrived
    assert turns == 4


def test_the_way_is_the_rest_where_cells_have_gone_on_by_themselves() -> None:
    box = stages(SMALL)
    while not box.places:
        box.step(at(0.14, -0.008, 0.3, parcel=SMALL), reported=False, there=False)
    box.overtaken()
    assert box.places == (GOAL,)
    box.overtaken()
    assert box.places == (GOAL,)


def test_a_box_that_would_not_tip_on_its_way_is_not_led_around_without_room() -> None:
    goal, start = Goal(-0.19, -0.03, 1.68), at(0.16, -0.01, -1.41, parcel=SMALL)
    footholds = Footholds(LAYOUT, SMALL.footprint, (0.0, 0.0))
    for room, corners in ((True, 1), (False, 0)):
        box = Stages(goal, footholds, lambda _, room=room: room)
        while not box.places:
            box.step(start, reported=False, there=False)
        assert len(box.places) == corners + 1
