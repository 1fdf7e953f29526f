"""Streams and exits that cannot be are refused by their keys."""

import pytest

from mdms_model.scenario.file import scenario_from
from mdms_model.scenario.scenario import ScenarioError


def tree(**changes):
    sizes = {"mass_kg": 2.0, "length_m": 0.3, "width_m": 0.3}
    plain = {
        "title": "stream",
        "array": {"columns": 6, "rows": 3},
        "cell": {"wheel": [{"direction_rad": 0.0}, {"direction_rad": 1.5708}]},
        "parcel": [{"name": "a", "kind": "box"} | sizes, {"name": "b", "kind": "box"} | sizes],
        "stream": [{"parcels": ["a", "b"], "x_m": -0.2}],
        "exit": [{"name": "out", "side": "east", "kinds": ["box"]}],
        "run": {"fidelity": "firmware"},
    }
    return plain | changes


def test_a_stream_with_an_exit_is_taken():
    scenario = scenario_from(tree())
    assert scenario.stream[0].parcels == ("a", "b")
    assert scenario.exit[0].kinds == ("box",)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"stream": [{"parcels": ["a", "c"]}]}, "stream.0.parcels.1 is 'c', but must be the name"),
        ({"stream": [{"parcels": ["a", "a"]}]}, "stream.0.parcels.1 is 'a', which stream.0.par"),
        ({"stream": [{"parcels": ["a"]}, {"parcels": ["a"]}]}, "stream.1.parcels.0 is 'a', which"),
        ({"stream": [{"parcels": []}]}, "stream.0.parcels has 0 items"),
        ({"stream": [{"parcels": ["a"], "x_m": 0.5}]}, "stream.0.x_m is 0.5, which puts the place"),
        ({"exit": [{"name": "out", "side": "up"}]}, "exit.0.side is 'up', but must be one of east"),
        ({"exit": [{"name": " ", "side": "east"}]}, "exit.0.name is ' '"),
        ({"exit": [{"name": "o", "side": "east", "kinds": ["disc"]}]}, "exit.0.kinds.0 is 'disc'"),
        (
            {"exit": [{"name": "o", "side": "east"}, {"name": "p", "side": "east"}]},
            "exit.1 overlaps exit 'o' on the east side",
        ),
        ({"exit": [{"name": "o", "side": "east", "from_m": 1.0, "to_m": 1.0}]}, "exit.0.from_m"),
        ({"run": {"fidelity": "ideal"}}, "stream is given, but run.fidelity is 'ideal'"),
    ],
)
def test_an_impossible_value_is_refused_by_its_key(changes, text):
    with pytest.raises(ScenarioError) as refused:
        scenario_from(tree(**changes))
    assert text in str(refused.value)


def test_a_parcel_of_a_stream_has_no_goal_of_its_own():
    changed = tree()
    changed["parcel"][0]["goal"] = {"x_m": 0.0, "y_m": 0.0}
    with pytest.raises(ScenarioError, match=r"stream.0.parcels.0 is 'a', which has a goal"):
        scenario_from(changed)
