"""What cells cannot steer is refused by the key's path."""

import pytest

from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import ScenarioError

TRIANGLE = "parcel.0.corners_m=[[-0.15, -0.15], [0.15, -0.15], [0.0, 0.15]]"


def test_the_host_steers_unless_the_scenario_says_otherwise():
    motion = load_scenario("array18").motion
    assert (motion.control, motion.go_on) == ("host", False)
    assert load_scenario("neighbours").motion.control == "cells"


def test_cells_steer_discs_too_and_may_go_on():
    overrides = ["parcel.0.shape=disc", "parcel.0.length_m=0.3", "parcel.0.goal.yaw_rad=0.0"]
    assert load_scenario("neighbours", [*overrides, "motion.go_on=true"]).motion.go_on


def test_cells_of_several_buses_steer_where_gateways_forward_all_that_they_need():
    scenario = load_scenario("array54", ["motion.control=cells", "array.forwarded=[1, 2, 3, 4]"])
    assert scenario.motion.control == "cells"
    with pytest.raises(ScenarioError) as caught:
        load_scenario("array54", ["motion.control=cells", "array.forwarded=[1, 2]"])
    assert "array.forwarded is [1, 2], but cells that steer need all PDOs" in str(caught.value)


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        (["motion.control=both"], "motion.control is 'both', but must be one of host, cells"),
        (["motion.go_on=1"], "motion.go_on is 1, but must be true or false"),
        (
            ["motion.control=host", "motion.go_on=true"],
            "motion.go_on is true, but motion.control is 'host'",
        ),
        (["motion.field=rotate"], "motion.control is 'cells', but motion.field is 'rotate'"),
        (["exit=[{name='east', side='east'}]"], "exit is given, but motion.control is 'cells'"),
        (["run.fidelity=ideal"], "motion.field is 'goal', but run.fidelity is 'ideal'"),
        (["motion.speed_m_s=1.5"], "motion.speed_m_s is 1.5, but a motion program has 1.27 m/s"),
        (
            ["wire.sync_period_s=0.02"],
            "motion.control is 'cells', whose beat is 0.01 s, but wire.sync_period_s is 0.02",
        ),
        (
            ["cell.wheel=[{direction_rad=0.0}]"],
            "motion.control is 'cells', which needs 2 wheels a cell, but cell.wheel has 1",
        ),
        (
            ["cell.sensor_offset_m=[[0.0, 0.0]]"],
            "motion.control is 'cells', which needs 5 sensors a cell",
        ),
        (["parcel.0.shape=polygon", TRIANGLE], "parcel.0.shape is 'polygon', but cells steer"),
        (["parcel.0.length_m=1.2"], "parcel.0.length_m is 1.2, but a motion program has 1.02 m"),
    ],
)
def test_refusals(overrides, expected):
    with pytest.raises(ScenarioError) as caught:
        load_scenario("neighbours", overrides)
    assert expected in str(caught.value)
