"""`mdms simulate` prints what a run came to, keeps it, and can run it again."""

import json
import re
from pathlib import Path

import pytest

import mdms_model.scenario
from mdms_host.cli import main

BUILTIN = Path(mdms_model.scenario.__file__).parent / "builtin"


def figures(capsys, *arguments):
    assert main(["simulate", *map(str, arguments), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_json_has_the_promised_names(capsys):
    told = figures(capsys, "paper-fig7", "--set", "run.duration_s=1")
    assert set(told) == {
        "title",
        "fidelity",
        "nodes",
        "seed",
        "duration_s",
        "wall_s",
        "compile_s",
        "real_time_factor",
        "status",
        "reason",
        "parcels",
        "goals",
        "fault",
        "slipping_share",
    }
    assert set(told["parcels"][0]) == {
        "name",
        "x_m",
        "y_m",
        "yaw_rad",
        "vx_m_s",
        "vy_m_s",
        "yaw_rate_rad_s",
        "at_rest",
    }


def test_figure_7_comes_to_rest_where_the_model_says(capsys):
    told = figures(capsys, "paper-fig7")
    assert told["parcels"][0]["x_m"] == pytest.approx(-0.0308531, abs=1e-4)
    assert told["parcels"][0]["at_rest"] is True
    assert told["duration_s"] == 20.0


def test_figure_8_keeps_moving(capsys):
    assert figures(capsys, "paper-fig8")["parcels"][0]["at_rest"] is False


def test_options_stand_above_the_file(capsys):
    told = figures(
        capsys, "paper-fig7", "--seed", 9, "--fidelity", "ideal", "--set", "run.duration_s=0.5"
    )
    assert (told["seed"], told["fidelity"], told["duration_s"]) == (9, "ideal", 0.5)
    assert told["nodes"] is None


def test_run_is_kept_and_gives_the_same_again(capsys, tmp_path):
    folder = tmp_path / "run"
    first = figures(capsys, "paper-fig9", "--set", "run.duration_s=2", "--out", folder)
    assert first["run"] == str(folder)
    assert json.loads((folder / "meta.json").read_text())["figures"] == first
    assert figures(capsys, folder)["parcels"] == first["parcels"]


def test_people_get_sentences(capsys):
    assert main(["simulate", "paper-fig7"]) == 0
    told = capsys.readouterr().out
    assert "Paper, figure 7" in told
    assert "box: x -0.0309 m, y +0.0000 m, yaw +0.0 deg, at rest" in told


def test_parcel_that_tips_is_a_failure(capsys):
    arguments = ["--set", "motion.field=uniform", "--set", "motion.speed_m_s=0.2"]
    assert main(["simulate", "paper-fig7", *arguments]) == 1
    assert "mdms: box tips at " in capsys.readouterr().err


def test_same_seed_same_figures(capsys):
    told = [figures(capsys, "paper-fig9")["parcels"] for _ in range(2)]
    assert told[0] == told[1]


def test_goal_that_is_not_reached_is_told_with_the_way_left_and_by_the_exit_code(capsys):
    """A box that no friction moves stands where it was put, though its wheels turn."""
    slippery = ("--set", "cell.friction=0.0001", "--set", "belief.friction=0.3")
    short = ("--set", "run.duration_s=9")
    assert main(["simulate", "array18", *slippery, *short, "--json"]) == 3
    told = capsys.readouterr()
    figures = json.loads(told.out)
    (goal,) = figures["goals"]
    assert goal["parcel"] == "box"
    assert (goal["reached"], goal["time_s"]) == (False, None)
    assert re.match(
        r"box does not get on, \d+ mm from its goal, tried 5 times: stopped", figures["fault"]
    )
    assert goal["position_error_m"] == pytest.approx(0.2, abs=0.03)
    assert abs(goal["yaw_error_rad"]) == pytest.approx(0.52, abs=0.1)
    assert figures["slipping_share"] > 0.7
    slip, warning, stopped, verdict = told.err.splitlines()
    assert "wheels slip under box" in slip
    assert "box does not get on" in warning
    assert float(warning.split()[0]) < 1.5
    assert "tried 5 times: stopped" in stopped
    assert re.match(
        r"mdms: goal not reached: box is 1\d\d\.\d mm and 2\d\.\d degrees from", verdict
    )


def test_goal_that_is_reached_is_told_with_its_time(capsys):
    told = figures(capsys, "array18", "--set", "run.duration_s=5")
    (goal,) = told["goals"]
    assert goal["reached"] is True
    assert goal["position_error_m"] < 0.002
    assert 1.0 < goal["time_s"] < 1.6
    assert told["slipping_share"] < 0.02


def test_fault_of_a_node_is_in_the_figures(capsys, tmp_path):
    scenario = tmp_path / "dies.toml"
    text = (BUILTIN / "array18.toml").read_text()
    fault = '[[fault]]\nkind = "off"\ncells = [8]\nstart_s = 1.0\n'
    short = "duration_s = 2.0\npauses = 0"
    scenario.write_text(text.replace("duration_s = 12.0", short) + fault)
    assert main(["simulate", str(scenario), "--json"]) == 5
    told = capsys.readouterr()
    assert "cell 8 (node 8) has fallen silent" in json.loads(told.out)["fault"]
    assert "mdms: cell 8 (node 8) has fallen silent" in told.err


def test_parcel_that_tips_is_the_fault_of_its_run(capsys):
    arguments = ["--set", "motion.field=uniform", "--set", "motion.speed_m_s=0.2", "--json"]
    assert main(["simulate", "paper-fig7", *arguments]) == 1
    assert json.loads(capsys.readouterr().out)["fault"].startswith("box tips at ")


def test_a_scenario_that_states_its_stop_refuses_heavier_parcels(capsys):
    stop = "stop={form='category_1', mass_kg=1.5, speed_m_s=0.6}"
    assert main(["simulate", "array18", "--set", stop]) == 2
    told = "mdms: parcel.0.mass_kg is 2, but the table's emergency stop holds 1.5 kg at most"
    assert told in capsys.readouterr().err
