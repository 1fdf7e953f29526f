"""Squeezes on the array: from where, until when, and how near to the field without gaps."""

from dataclasses import replace

import numpy as np
import pytest

from mdms_model.array import build_wheels
from mdms_model.fields import references_m_s
from mdms_model.outline import outline_m, outline_of
from mdms_model.scenario.motion import Part
from mdms_model.scenario.scenario import Array, Cell, Parcel, Run, Scenario, Wheel
from mdms_model.squeeze import plan_squeezes, squeeze_function
from mdms_model.statics.support_margin import support_margin_m
from mdms_sim.physics.squeeze_trials import (
    StepEnding,
    Trials,
    final_error_rad,
    random_poses,
    share_within,
    step_outcomes,
    try_squeezes,
)

TOGETHER = (Wheel(0.0), Wheel(np.pi / 2))
PLATE = Parcel("plate", 2.0, 0.4, 0.2)


def table(pitch_m, cells, friction):
    return Scenario(
        "table",
        Array(cells, cells, pitch_m),
        Cell(wheel=TOGETHER, friction=friction),
        (PLATE,),
        run=Run(fidelity="ideal", step_s=0.01),
    )


#: Small cells from which no wheel slips: as near to a field without gaps as is simulated quickly.
FINE = table(0.025, 28, friction=100.0)
COARSE = table(0.127, 6, friction=0.3)


def fields(scenario, plan, speed_m_s=0.2):
    wheels = build_wheels(scenario)
    return [
        references_m_s(Part("squeeze", speed_m_s=speed_m_s, heading_rad=step.heading_rad), wheels)
        for step in plan.steps
    ]


def plan_for(corners_m):
    return plan_squeezes(squeeze_function(np.array(corners_m)))


PLAN = plan_for([(-0.2, -0.1), (0.2, -0.1), (0.2, 0.1), (-0.2, 0.1)])


def test_poses_are_the_seeds_and_stand_on_the_table():
    poses = random_poses(COARSE, PLATE, 40, seed=3)
    np.testing.assert_array_equal(poses, random_poses(COARSE, PLATE, 40, seed=3))
    assert not np.array_equal(poses, random_poses(COARSE, PLATE, 40, seed=4))
    half_m = COARSE.array.columns * COARSE.array.pitch_m / 2
    wheel_m, outline = build_wheels(COARSE).position_m, outline_of(PLATE)
    for pose in poses:
        assert (np.abs(outline_m(pose, PLATE)) <= half_m + 1e-9).all()
        assert support_margin_m(wheel_m, outline, (0.0, 0.0), tuple(pose)) > 0.0
    assert np.ptp(poses[:, 2]) > 5.0
    assert np.ptp(poses[:, 0]) > 0.2


def test_a_parcel_that_nowhere_stands_has_no_poses():
    assert not len(random_poses(COARSE, replace(PLATE, length_m=0.05, width_m=0.05), 1, seed=1))


def test_on_fine_cells_a_plate_comes_to_where_a_field_without_gaps_turns_it():
    poses = random_poses(FINE, PLATE, 6, seed=1)
    trials = try_squeezes(FINE, PLATE, fields(FINE, PLAN), poses, limit_s=60.0)
    (outcome,) = step_outcomes(PLAN, trials)
    assert trials.rests.all()
    assert outcome.count(StepEnding.TIPPED) == 0
    # A row of wheels is as much as 3.6 degrees of the plate's length.
    assert share_within(final_error_rad(PLAN, trials), np.radians(8.0)) == 1.0


def test_on_wide_cells_it_comes_to_rest_elsewhere():
    poses = random_poses(COARSE, PLATE, 12, seed=1)
    trials = try_squeezes(COARSE, PLATE, fields(COARSE, PLAN), poses, limit_s=20.0)
    assert share_within(final_error_rad(PLAN, trials), np.radians(8.0)) < 0.8


def test_a_squeeze_without_push_leaves_the_parcel_where_it_is():
    poses = random_poses(COARSE, PLATE, 3, seed=1)
    trials = try_squeezes(COARSE, PLATE, fields(COARSE, PLAN, 0.0), poses, limit_s=5.0)
    np.testing.assert_allclose(trials.pose[:, 1], trials.pose[:, 0], atol=1e-9)
    assert trials.rests.all()


def test_a_parcel_that_tips_has_no_pose_any_more():
    poses = np.array([[0.0, 0.0, 0.0], [0.36, 0.36, 0.8]])
    trials = try_squeezes(COARSE, PLATE, fields(COARSE, PLAN) * 2, poses, limit_s=1.0)
    assert not np.isnan(trials.pose[0]).any()
    assert np.isnan(trials.pose[1, 1:]).all()


@pytest.mark.parametrize(
    ("yaw_deg", "rests", "ending"),
    [
        (2.0, True, StepEnding.AS_PREDICTED),
        (182.0, True, StepEnding.AS_PREDICTED),
        (20.0, True, StepEnding.STUCK),
        (20.0, False, StepEnding.MOVING),
        (50.0, True, StepEnding.WRONG_WAY),
        (np.nan, False, StepEnding.TIPPED),
    ],
)
def test_endings_of_a_step_that_should_turn_a_plate_back_to_yaw_0(yaw_deg, rests, ending):
    pose = np.zeros((1, 2, 3))
    pose[0, :, 2] = np.radians([40.0, yaw_deg])
    (outcome,) = step_outcomes(PLAN, Trials(pose, np.array([[rests]])))
    assert outcome.ending == (ending,)


def test_a_step_after_one_that_tipped_has_not_begun():
    two = plan_for([(-0.2, -0.17), (0.2, -0.17), (0.02, 0.19)])
    pose = np.full((1, 4, 3), np.nan)
    pose[0, 0] = 0.0
    endings = [each.ending for each in step_outcomes(two, Trials(pose, np.zeros((1, 3), bool)))]
    assert endings == [(StepEnding.TIPPED,), (StepEnding.NONE,), (StepEnding.NONE,)]
