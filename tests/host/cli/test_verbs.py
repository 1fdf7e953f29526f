"""`scenarios`, `limits`, `plot` and `export`."""

import json

import pytest

from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode
from mdms_model.run.folder import TABLES
from mdms_model.scenario.file import load_scenario


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("verbs") / "run"
    assert main(["simulate", "paper-fig7", "--set", "run.duration_s=1", "--out", str(folder)]) == 0
    return folder


def test_scenarios_are_listed_with_their_titles(capsys):
    assert main(["scenarios"]) == 0
    assert "paper-fig7  Paper, figure 7: full rolling" in capsys.readouterr().out
    assert main(["scenarios", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)["scenarios"]
    assert {"name": "paper-fig7", "title": "Paper, figure 7: full rolling"} in listed


@pytest.mark.parametrize(
    ("resistance_ohm", "rolling_m_s", "sliding_m_s"), [(4, 0.0635, 0.21), (5, 0.0793, 0.26)]
)
def test_limits_are_the_papers(capsys, resistance_ohm, rolling_m_s, sliding_m_s):
    change = f"cell.resistance_ohm={resistance_ohm}"
    assert main(["limits", "paper-fig7", "--json", "--set", change]) == 0
    (parcel,) = json.loads(capsys.readouterr().out)["parcels"]
    assert parcel["rolling_max_m_s"] == pytest.approx(rolling_m_s, abs=5e-5)
    assert parcel["sliding_min_m_s"] == pytest.approx(sliding_m_s, abs=5e-3)
    assert set(parcel) == {
        "name",
        "supports_min",
        "supports_max",
        "normal_min_n",
        "normal_max_n",
        "rolling_max_m_s",
        "sliding_min_m_s",
        "rolling_equilibrium_max_m_s",
        "droop",
    }


def test_a_built_in_scenario_is_printed_as_a_file_to_start_from(capsys, tmp_path):
    assert main(["scenarios", "--show", "array18"]) == 0
    printed = capsys.readouterr().out
    assert "# not the 5 it prints" in printed
    path = tmp_path / "mine.toml"
    path.write_text(printed)
    assert load_scenario(path) == load_scenario("array18")
    assert main(["scenarios", "--show", "array18", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"name": "array18", "toml": printed}
    assert main(["scenarios", "--show", "array19"]) == ExitCode.USAGE
    assert "no such built-in scenario; there are array18, " in capsys.readouterr().err


def test_limits_for_people_name_the_equations(capsys):
    assert main(["limits", "paper-fig7"]) == 0
    told = capsys.readouterr().out
    assert "(eq 14)" in told
    assert "0.06346 m/s" in told


def test_plot_draws_into_the_run_or_a_file(run, tmp_path, capsys):
    (run / "picture.png").unlink()
    assert main(["plot", str(run)]) == 0
    assert capsys.readouterr().out == f"{run / 'picture.png'}\n"
    assert main(["plot", str(run), "--out", str(tmp_path / "mine.png")]) == 0
    assert (tmp_path / "mine.png").read_bytes() == (run / "picture.png").read_bytes()


def test_plot_into_nowhere_is_refused(run, capsys):
    assert main(["plot", str(run), "--out", str(run / "none" / "mine.png")]) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_export_writes_all_tables(run, tmp_path, capsys):
    assert main(["export", str(run), "--csv", str(tmp_path / "tables")]) == 0
    paths = capsys.readouterr().out.split()
    assert paths == [str(tmp_path / "tables" / name) for name in TABLES]


def test_export_over_a_file_is_refused(run, capsys):
    assert main(["export", str(run), "--csv", str(run / "meta.json")]) == 2
    assert "cannot be written" in capsys.readouterr().err
