"""`mdms simulate` prints what a run came to, keeps it, and can run it again."""

import json

import pytest

from mdms_host.cli import main


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
        "parcels",
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
