"""A box crosses a cell that has died; the cell comes back meanwhile, or the host goes."""

from math import hypot

import pytest
from tests.system.trouble.rows_by_cells import GO_ON, GOAL, TABLE

import mdms_array as mdms
from mdms_model.scenario.file import load_scenario

KILLED = "{kind='off', cells=[6], start_s=1.2}"
BACK = "{kind='off', cells=[6], start_s=1.2, duration_s=2.6}"
CUT_OFF = "{kind='cut', cells=[6], start_s=1.2, duration_s=2.6}"
CUT_OFF_FOR_A_SECOND = "{kind='cut', cells=[6], start_s=1.2, duration_s=1.0}"


def run_of(*faults, duration_s=7.0):
    """The run of a box that lies on cell 6 all the way."""
    more = (GO_ON, f"run.duration_s={duration_s}", f"fault=[{', '.join(faults)}]")
    return mdms.simulate(load_scenario("array18", [*TABLE, *more]))


def off_goal_m(run):
    """How far the box is from its goal in truth."""
    x_m, y_m, _ = run.record.pose[-1, 0]
    return hypot(x_m - GOAL[0], y_m - GOAL[1])


def texts_of(run):
    return " | ".join(each.text for each in run.incidents)


@pytest.mark.slow
@pytest.mark.parametrize("fault", [KILLED, BACK, CUT_OFF, CUT_OFF_FOR_A_SECOND])
def test_box_arrives_though_a_cell_under_it_is_lost_or_comes_back(fault):
    run = run_of(fault)
    assert not run.violations
    assert off_goal_m(run) < 0.003, texts_of(run)
    assert bool(run.lost_cells) is (fault == KILLED)


@pytest.mark.slow
def test_box_stands_on_the_lost_cell_when_the_host_is_gone():
    run = run_of(KILLED, "{kind='host', start_s=3.4}", duration_s=6.0)
    assert not run.violations
    assert off_goal_m(run) > 0.003
    pose = run.record.pose[:, 0]
    assert hypot(*(pose[-1, :2] - pose[len(pose) * 2 // 3, :2])) < 0.001
