"""Rules of buses, and of scenarios whose cells steer."""

import pytest

from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import ScenarioError

SMALL = ["array.columns=4", "array.rows=1", "parcel.0.goal={x_m=0.0, y_m=0.0}", "parcel.0.x_m=0.0"]


def load(*overrides):
    return load_scenario("array18", [*SMALL, *overrides])


def test_lists_of_cells_are_read():
    assert load("array.buses=[[1, 2], [4, 3]]").array.buses == ((1, 2), (4, 3))
    assert load().array.buses == ()


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (["array.buses=[[1, 2], [3, 5]]"], r"array.buses.1.1 is 5, but the array has 4 cells"),
        (["array.buses=[[1, 2], [3, 0]]"], r"array.buses.1.1 is 0, but must be at least 1"),
        (["array.buses=[[1, 2, 3], [3, 4]]"], r"array.buses.1.0 is 3, but cell 3 is in array.bus"),
        (["array.buses=[[1, 2], [3]]"], r"array.buses lacks cell 4"),
        (
            ["array.buses=[[1, 2], [], [3, 4]]"],
            r"array.buses.1 has 0 items, but must have 1",
        ),
        (["array.buses=[1, 2]"], r"array.buses.0 is 1, but must be a list"),
        (["array.forwarded=[1]"], r"array.forwarded needs several buses"),
        (
            ["array.buses=[[1, 2], [3, 4]]", "array.forwarded=[5]"],
            r"array.forwarded.0 is 5, but must be at least 1 and at most 4",
        ),
        (["array.columns=127"], r"array has 127 x 1 cells, but one bus takes at most 126"),
        (['fault=[{kind="loss", bus=1}]'], r"fault.0.bus has 1, but buses are numbered 0 to 0"),
        (
            ["array.buses=[[1, 2], [3, 4]]", 'fault=[{kind="off", cells=[1], bus=1}]'],
            r"fault.0.bus is 1, but 'off' is of cells or parcels",
        ),
    ],
)
def test_buses_that_do_not_fit_are_refused_with_their_key(overrides, told):
    with pytest.raises(ScenarioError, match=told):
        load(*overrides)


def test_more_cells_than_one_bus_takes_may_be_on_several():
    halves = [list(range(1, 101)), list(range(101, 201))]
    assert load("array.columns=200", f"array.buses={halves}").array.columns == 200


def test_cells_around_a_bus_must_find_node_ids_on_it():
    # A bus of 60 cells in every second column, and so 120 or more of others around it.
    own = [number for number in range(1, 361) if number % 2 == 0 and number > 240]
    others = [number for number in range(1, 361) if number not in own]
    lists = [own, others[:120], others[120:200], others[200:]]
    with pytest.raises(ScenarioError, match=r"array.forwarded: bus 0 has node ids up to 60"):
        load("array.columns=120", "array.rows=3", f"array.buses={lists}", "array.forwarded=[1]")


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
        (["array.pitch_m=1.5"], "lengths up to 1 m, but array.pitch_m is 1.5"),
        (["cell.wheel.1.offset_m=[0.0, -3.0]"], "but cell.wheel.1.offset_m.1 is -3"),
        (["cell.sensor_offset_m.3=[1.01, 0.0]"], "but cell.sensor_offset_m.3.0 is 1.01"),
        (
            ["belief.wheel=[{offset_m=[3.0, 0.0]}, {direction_rad=1.57}]"],
            "but belief.wheel.0.offset_m.0 is 3",
        ),
        (["parcel.0.shape=polygon", TRIANGLE], "parcel.0.shape is 'polygon', but cells steer"),
        (["parcel.0.length_m=1.2"], "parcel.0.length_m is 1.2, but a motion program has 1.02 m"),
    ],
)
def test_refusals(overrides, expected):
    with pytest.raises(ScenarioError) as caught:
        load_scenario("neighbours", overrides)
    assert expected in str(caught.value)


def test_a_step_that_moves_parcels_elsewhere_is_refused():
    ideal = ["run.fidelity='ideal'", "motion.field='inward'"]
    load_scenario("array18", [*ideal, "run.step_s=0.01"])
    with pytest.raises(ScenarioError, match=r"run.step_s is 0.5, but must be at most 0.01"):
        load_scenario("array18", [*ideal, "run.step_s=0.5"])
