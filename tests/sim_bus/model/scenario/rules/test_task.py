"""Tasks that cannot be done are refused by their keys."""

import pytest
from tests.sim_bus.model.scenario.rules.test_stream import tree

from mdms_model.scenario.file import scenario_from
from mdms_model.scenario.scenario import ScenarioError

BOX = {"name": "box", "mass_kg": 2.0, "length_m": 0.3, "width_m": 0.3}


def program(*tasks, **changes):
    parcels = [*tree()["parcel"], BOX, BOX | {"name": "other", "x_m": 0.3}]
    wheels = {"motion": {"field": "program"}, "task": list(tasks), "parcel": parcels}
    return tree(**wheels | changes)


@pytest.mark.parametrize(
    "task",
    [
        {"do": "transport", "parcel": "box", "x_m": 0.1, "y_m": 0.0, "yaw_rad": 0.5},
        {"do": "name", "parcel": "crate", "x_m": 0.1, "y_m": 0.0, "length_m": 0.3},
        {"do": "swap", "parcels": ["box", "other"]},
        {"do": "sort"},
        {"do": "merge", "exit": "out", "count": 3},
        {"do": "singulate", "exit": "out", "period_s": 2.0},
        {"do": "buffer", "exit": "out", "places": [[0.0, 0.0], [0.1, 0.1]], "order": ["box"]},
        {"do": "wait", "period_s": 1.0},
    ],
)
def test_tasks_of_all_kinds_are_taken(task):
    assert scenario_from(program(task)).task[0].do == task["do"]


@pytest.mark.parametrize(
    ("task", "text"),
    [
        (
            {"do": "name", "parcel": "unknown-3", "x_m": 0.1, "y_m": 0.0},
            "task.0.parcel is 'unknown-3', but is a name that the host gives to unknown things",
        ),
        ({"do": "fly"}, "task.0.do is 'fly', but must be one of transport, name, swap"),
        ({"do": "transport", "parcel": "box", "x_m": 0.1}, "task.0.y_m is missing"),
        ({"do": "sort", "parcel": "box"}, "task.0.parcel is given, but 'sort' has only count"),
        (
            {"do": "transport", "parcel": "a", "x_m": 0.1, "y_m": 0.0},
            "task.0.parcel is 'a', but must be a parcel that lies on the table: box, other",
        ),
        (
            {"do": "transport", "parcel": "box", "x_m": 0.1, "y_m": 0.5},
            "task.0.y_m is 0.5, which puts the place off the table",
        ),
        ({"do": "swap", "parcels": ["box"]}, "task.0.parcels is ['box'], but must be two"),
        ({"do": "merge", "exit": "in"}, "task.0.exit is 'in', but must be one of out"),
        (
            {"do": "buffer", "exit": "out", "places": [[0.1, 0.0], [0.5, 0.0]]},
            "task.0.places.1.0 is 0.5, which puts the place off the table",
        ),
        (
            {"do": "buffer", "exit": "out", "places": [[0.0, 0.0]], "order": ["a", "bix"]},
            "task.0.order.1 is 'bix', but must be the name or the kind of a parcel: a, box, b, oth",
        ),
        ({"do": "sort", "beside": True}, "task.0.beside is true, but no task comes before it"),
        ({"do": "sort", "cout": 1}, "task.0.cout is not a known key; did you mean count?"),
    ],
)
def test_an_impossible_task_is_refused_by_its_key(task, text):
    with pytest.raises(ScenarioError) as refused:
        scenario_from(program(task))
    assert text in str(refused.value)


def test_a_named_thing_may_be_moved_thereafter_and_not_before():
    name = {"do": "name", "parcel": "crate", "x_m": 0.1, "y_m": 0.0}
    move = {"do": "transport", "parcel": "crate", "x_m": -0.1, "y_m": 0.0}
    assert len(scenario_from(program(name, move)).task) == 2
    with pytest.raises(ScenarioError, match=r"task\.0\.parcel is 'crate', but must be a parcel"):
        scenario_from(program(move, name))


def test_sorting_needs_an_exit_for_each_kind_that_comes():
    with pytest.raises(ScenarioError, match=r"task.0 is to sort 'a' by its kind, 'box', but no"):
        scenario_from(program({"do": "sort"}, exit=[{"name": "out", "side": "east"}]))


def test_tasks_need_a_program_and_a_program_needs_cells():
    with pytest.raises(ScenarioError, match=r"task is given, but motion\.field is 'inward'"):
        scenario_from(program({"do": "wait", "period_s": 1.0}, motion={}))
    with pytest.raises(ScenarioError, match=r"motion\.field is 'program', but run\.fidelity is"):
        scenario_from(
            program(run={"fidelity": "ideal"}, stream=[], exit=[]),
        )
