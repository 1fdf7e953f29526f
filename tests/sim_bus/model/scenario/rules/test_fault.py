"""Faults of absent things, and pushes beyond all measure, are refused by the key's path."""

import pytest

from mdms_model.scenario.file import load_scenario, read_tree, scenario_from
from mdms_model.scenario.scenario import ScenarioError
from mdms_model.scenario.tree import plain


def faulty(fidelity="firmware", **fault):
    tree = read_tree("array18")
    tree["run"]["fidelity"] = fidelity
    return tree | {"fault": [fault]}


def refusal(**keys):
    with pytest.raises(ScenarioError) as caught:
        scenario_from(faulty(**keys))
    return str(caught.value)


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"kind": "off", "cells": [19]}, "fault.0.cells has 19, but the array has 18 cells"),
        ({"kind": "loss", "seen_by": [19]}, "fault.0.seen_by has 19, but the array has 18 cells"),
        (
            {"kind": "sensor_stuck", "sensors": [5]},
            "fault.0.sensors.0 is 5, but must be at",
        ),
        ({"kind": "sensor_stuck", "covered": 1}, "fault.0.covered is 1, but must be true or false"),
        ({"kind": "wheel_jammed", "axes": [0]}, "fault.0.axes.0 is 0, but must be at least 1"),
        ({"kind": "wheel_jammed", "axes": [3]}, "fault.0.axes.0 is 3, but must be at least 1"),
        ({"kind": "push", "impulse_n_s": [1, 0]}, "fault.0.parcel is '', but must be one of box"),
        ({"kind": "lift", "parcel": "bax"}, "fault.0.parcel is 'bax', but must be one of box"),
        ({"kind": "wrong_place"}, "fault.0.cells is [], but must be one cell"),
        ({"kind": "wrong_place", "cells": [2]}, "fault.0.as_cell is None, but must be another"),
        (
            {"kind": "wrong_place", "cells": [2], "as_cell": 19},
            "fault.0.as_cell has 19, but the array has 18 cells",
        ),
        ({"kind": "push", "parcel": "box"}, "fault.0.impulse_n_s is [0, 0], and"),
        (
            {"kind": "push", "parcel": "box", "twist_nms": 0.1, "duration_s": 1.0},
            "fault.0.duration_s is 1.0, but a push takes no time",
        ),
        (
            {"kind": "push", "parcel": "box", "impulse_n_s": [30.0, 0.0]},
            "fault.0.impulse_n_s is [30.0, 0.0], which makes 'box' 15 m/s faster",
        ),
        ({"kind": "push", "parcel": "box", "twist_nms": 9.0}, "fault.0.twist_nms is 9.0, which"),
        (
            {"kind": "lift", "parcel": "box", "duration_s": 1.0, "x_m": 0.4},
            "fault.0.x_m is 0.4, which puts 'box' off the table",
        ),
        (
            {"kind": "lift", "parcel": "box", "y_m": 0.1},
            "fault.0.duration_s is missing, so 'box' is never set down",
        ),
        (
            {"kind": "bridge_fault", "brake": True},
            "fault.0.brake is true, but 'bridge_fault' shorts no motor",
        ),
        ({"kind": "host", "cells": [1]}, "fault.0.cells has 1, but 'host' is of no cell"),
        ({"kind": "host", "fidelity": "ideal"}, "motion.field is 'goal', but run.fidelity is"),
    ],
)
def test_a_fault_that_cannot_be_is_refused_by_its_key(keys, expected):
    assert refusal(**keys).startswith(expected)


def test_sensors_and_axes_that_the_cells_lack_are_refused():
    tree = faulty(kind="sensor_stuck", sensors=[0, 2])
    tree["cell"]["sensor_offset_m"] = [[0.0, 0.0], [0.03, 0.03]]
    with pytest.raises(ScenarioError, match=r"fault\.0\.sensors has 2, but a cell has 2 sensors"):
        scenario_from(tree)
    tree = faulty(kind="motor_reversed", axes=[2])
    tree["cell"]["wheel"] = [{}]
    with pytest.raises(ScenarioError, match=r"fault\.0\.axes has 2, but a cell has 1 wheels"):
        scenario_from(tree)


def test_faults_need_cells_and_a_bus():
    tree = faulty("ideal", kind="host")
    tree["motion"] = {"field": "uniform", "speed_m_s": 0.1}
    with pytest.raises(ScenarioError, match=r"fault\.0 needs cells and a bus"):
        scenario_from(tree)


def test_faults_of_the_world_survive_a_round_trip_and_are_set_on_the_command_line():
    tree = faulty(kind="lift", parcel="box", start_s=1.0, duration_s=0.5, x_m=0.1)
    scenario = scenario_from(tree)
    assert scenario_from(plain(scenario)) == scenario
    assert load_scenario("array18", ["fault=[{kind='host', start_s=2.0}]"]).fault[0].start_s == 2.0


def test_cells_with_one_node_id_are_alike_to_a_place_code():
    """Cells 1 and 3 are both node 1 of their buses, cell 4 is node 2."""
    tree = read_tree("array18")
    buses = [[1, 2, 7, 8, 13, 14], [3, 4, 9, 10, 15, 16], [5, 6, 11, 12, 17, 18]]
    tree["array"] |= {"buses": buses, "coded_places": True}
    other = {"kind": "wrong_place", "cells": [1], "as_cell": 4}
    scenario_from(tree | {"fault": [other]})
    with pytest.raises(ScenarioError) as caught:
        scenario_from(tree | {"fault": [other | {"as_cell": 3}]})
    assert "fault.0.as_cell is 3, but that cell has node id 1 on its bus" in str(caught.value)
    tree["array"] |= {"coded_places": False}
    scenario_from(tree | {"fault": [other | {"as_cell": 3}]})


def test_a_node_id_that_no_code_has_is_refused_where_places_are_coded():
    tree = read_tree("array18")
    tree["array"] |= {"columns": 8, "rows": 8}
    scenario_from(tree)
    tree["array"] |= {"coded_places": True}
    with pytest.raises(ScenarioError) as caught:
        scenario_from(tree)
    assert "but cell 64 has node id 64, and codes of places end at 63" in str(caught.value)
