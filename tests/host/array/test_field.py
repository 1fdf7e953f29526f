"""Fields and policies as `simulate`, `map` and `limits` have them."""

import json

import numpy as np
import pytest

from mdms_array.host import coordinator_of
from mdms_host.cli import main
from mdms_model.errors import InputError
from mdms_model.fields import PolicyError
from mdms_model.scenario.file import load_scenario

FAST = ("--set", "motion.policy=rolling", "--set", "run.duration_s=0.5")
CLAMP = ("--set", "motion.outside=clamp")


def test_simulate_refuses_a_field_outside_the_policy_with_exit_2(capsys):
    assert main(["simulate", "paper-fig7", *FAST]) == 2
    said = capsys.readouterr().err
    assert said.startswith("mdms: motion.policy is 'rolling', but 10 of 10 wheels")
    assert "(eq 14)" in said
    assert said.count("\n") == 1


def test_simulate_clamps_where_asked_and_says_so_once(capsys):
    assert main(["simulate", "paper-fig7", *FAST, *CLAMP, "--json"]) == 0
    result = capsys.readouterr()
    assert result.err.count("eq 14") == 1
    assert result.err.endswith("; clamped\n")
    (parcel,) = json.loads(result.out)["parcels"]
    assert parcel["x_m"] > -0.34925


def test_map_obeys_the_policy(capsys, tmp_path):
    picture = tmp_path / "map.png"
    assert main(["map", "paper-fig7", *FAST, "--out", str(picture)]) == 2
    assert "eq 14" in capsys.readouterr().err
    assert not picture.exists()


def test_limits_have_the_references_of_the_field_beside_those_of_its_policy(capsys):
    assert main(["limits", "paper-fig7", *FAST, "--json"]) == 0
    motion = json.loads(capsys.readouterr().out)["motion"]
    assert motion["field"] == "inward"
    assert motion["fastest_m_s"] == motion["slowest_m_s"] == 0.0635
    assert motion["limit_m_s"] == pytest.approx(0.0634625, rel=1e-5)
    assert (motion["wheels_outside"], motion["wheels"]) == (10, 10)
    assert motion["outside"] == "refuse"
    assert main(["limits", "paper-fig7", *FAST]) == 0
    said = capsys.readouterr().out
    assert "references of the field 'inward'" in said
    assert "wheels outside it, refused" in said


@pytest.mark.compiles
def test_limits_of_a_run_to_goals_have_no_field(capsys):
    assert main(["limits", "array18", "--json"]) == 0
    assert "motion" not in json.loads(capsys.readouterr().out)


def test_the_coordinator_plays_a_field_within_its_policy():
    field = ["motion.field=inward", "motion.speed_m_s=0.01", "motion.policy=sliding"]
    with pytest.raises(PolicyError, match="eq 15"):
        coordinator_of(load_scenario("array18", field))
    program = coordinator_of(load_scenario("array18", [*field, "motion.outside=clamp"]))._program
    references_m_s = program.references_m_s({}, 0.01)
    assert np.unique(abs(references_m_s).round(4)).tolist() == [0.0, 0.0462]


def test_the_coordinator_refuses_a_field_too_fast_for_the_wire():
    with pytest.raises(InputError, match=r"wheels would be set to \d+ m/s"):
        coordinator_of(load_scenario("array18", ["motion.field=uniform", "motion.speed_m_s=90"]))
