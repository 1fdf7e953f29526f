"""Goals at which a parcel would tip are refused, whoever steers it there."""

import numpy as np
import pytest

from mdms_array.host import coordinator_of
from mdms_host.estimation.parcel import Parcel
from mdms_host.layout import Layout
from mdms_host.motion.goal import GoalPose
from mdms_host.motion.safe_goals import SafeGoals, TippingError
from mdms_model.scenario.file import load_scenario

#: 6 x 3 cells reach to 0.381 m and 0.1905 m from their middle.
LAYOUT = Layout(6, 3)
BOX = Parcel("box", 0.36, 0.30)
MIDDLE = np.zeros(3)


def refused(goal, start=MIDDLE, parcel=BOX, straight=True, **centres_of_mass_m):
    try:
        SafeGoals(LAYOUT, centres_of_mass_m).check(parcel, start, goal, straight=straight)
    except TippingError as error:
        return str(error)
    return ""


def test_goal_beyond_the_edge_is_refused_and_one_on_the_table_is_not():
    assert not refused(GoalPose(0.15, 0.0, 0.0))
    assert refused(GoalPose(0.45, 0.0, 0.0)).startswith(
        "box would tip there: its centre of mass would"
    )
    assert refused(GoalPose(0.9, 0.0, None), start=None)


def test_the_centre_of_mass_counts():
    edge = GoalPose(0.28, 0.0, 0.0)
    assert not refused(edge)
    assert refused(edge, box=(0.1, 0.0))


def test_way_counts_where_it_is_straight():
    """A short box stands on three wheels' columns at both ends, and on two on the way."""
    short = Parcel("box", 0.25, 0.28)
    start, goal = np.array([-0.17, 0.0, 0.0]), GoalPose(-0.05, 0.0, 0.0)
    assert refused(goal, start, short) == "box would tip on the straight way there"
    assert not refused(goal, start, short, straight=False)


def test_parcel_that_is_about_to_tip_may_stay_and_be_taken_to_where_it_stands_better():
    hanging = np.array([0.42, 0.0, 0.0])
    assert refused(GoalPose(0.42, 0.0, 0.0))
    assert not refused(GoalPose(0.42, 0.0, 0.0), hanging)
    assert not refused(GoalPose(0.40, 0.0, 0.0), hanging)
    assert refused(GoalPose(0.46, 0.0, 0.0), hanging)


@pytest.mark.parametrize(
    "overrides",
    [
        (),
        ("motion.control='cells'",),
        ("motion.field='program'", "task=[{do='transport', parcel='box', x_m=0.1, y_m=0.0}]"),
    ],
    ids=["host", "cells", "program"],
)
def test_coordinator_refuses_it_and_the_parcel_keeps_the_goal_that_it_has(overrides):
    coordinator = coordinator_of(load_scenario("array18", [*overrides]))
    before = dict(coordinator.goals)
    with pytest.raises(TippingError, match="box would tip there"):
        coordinator.set_goal("box", GoalPose(0.9, 0.0, 0.0))
    assert coordinator.goals == before
