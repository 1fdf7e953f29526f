"""Tuning: the same proposals each time, bounds that are kept, and a check on unseen seeds."""

import json
import sqlite3
from contextlib import closing

import pandas
import pytest
from tests.host.experiments.one_process import run_here

from mdms_array.experiments.files import read_tuning
from mdms_array.experiments.sweep import run_design
from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode
from mdms_model.scenario.file import load_scenario

FILE = """
scenario = "paper-fig8"
seeds = 1
trials = 12
unseen = 2
minimise = "own.py:miss"

[bounds]
reached = { at_least = 1.0 }
"own.py:speed" = { at_most = 12.0 }

[vary]
"cell.friction" = { uniform = [0.1, 0.6] }
"motion.speed_m_s" = { log_uniform = [2.0, 20.0] }
"""
OWN = """
def miss(run): return (run.scenario.cell.friction - 0.4) ** 2
def unlucky(run): return miss(run) if run.scenario.run.seed == 5 or is_base(run) else None
def is_base(run): return run.scenario.cell.friction == 0.3
def speed(run): return run.scenario.motion.speed_m_s
def raises(run): raise ValueError("no value")
"""


@pytest.fixture
def file(tmp_path, monkeypatch):
    """A file of tuning with measures of its own beside it."""
    run_here(monkeypatch)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text(OWN)
    path = tmp_path / "grip.toml"
    path.write_text(FILE)
    return path


def tuned(capsys, *more):
    code = main(["tune", "grip.toml", "--workers", "1", "--json", *more])
    return code, json.loads(capsys.readouterr().out)


def runs_in(path):
    with closing(sqlite3.connect(path)) as journal:
        return journal.execute("SELECT key, columns FROM runs").fetchall()


def test_tuning_finds_better_values_within_bounds_and_repeats(file, capsys):
    code, first = tuned(capsys)
    assert code == ExitCode.OK
    assert first["better"]
    assert abs(first["best"]["setting"]["cell.friction"] - 0.4) < 0.1
    assert first["best"]["setting"]["motion.speed_m_s"] <= 12.0
    assert first["base"] == {
        "setting": {"cell.friction": 0.3, "motion.speed_m_s": 10.0},
        "mean": pytest.approx(0.01),
        "within_bounds": True,
    }
    # Without chance there is one run of each, and no interval.
    assert first["gain"] == [pytest.approx(0.01, abs=0.01), None, None]
    assert max(first["importance"], key=first["importance"].get) == "cell.friction"
    runs = runs_in(file.parent / "runs" / "grip" / "journal.sqlite")
    # All runs are in the journal, and the sampler proposes the same again.
    assert tuned(capsys) == (ExitCode.OK, first)
    assert runs_in(file.parent / "runs" / "grip" / "journal.sqlite") == runs
    assert (file.parent / "runs" / "grip" / "tuning.png").is_file()
    assert len(pandas.read_csv(file.parent / "runs" / "grip" / "table.csv")) == 12


def test_a_best_without_chance_is_compared_once(file, capsys):
    assert main(["tune", "grip.toml", "--workers", "1"]) == ExitCode.OK
    told = capsys.readouterr().out
    assert "in one run of each: without chance all are alike" in told
    assert "unseen" not in told
    assert read_tuning(file).unseen == 1


def test_a_best_with_chance_has_an_interval(file, capsys):
    text = FILE.replace(
        '"cell.friction"', '"cell.motor_spread" = { uniform = [0, 0.1] }\n"cell.friction"'
    )
    file.write_text(text.replace("trials = 12", "trials = 4"))
    _, figures = tuned(capsys)
    gain, low, high = figures["gain"]
    assert low <= gain <= high
    assert main(["tune", "grip.toml", "--workers", "1"]) == ExitCode.OK
    assert "on 2 unseen seeds, in pairs" in capsys.readouterr().out


def test_where_nothing_keeps_the_bounds_the_end_is_a_failure(file, capsys):
    file.write_text(FILE.replace("at_most = 12.0", "at_most = 1.0").replace("= 12\n", "= 4\n"))
    assert main(["tune", "grip.toml", "--workers", "1"]) == ExitCode.FAILURE
    assert "no trial keeps all bounds" in capsys.readouterr().out


def test_runs_that_raise_are_no_end(file, capsys):
    changed = FILE.replace("own.py:miss", "own.py:raises").replace("trials = 12", "trials = 2")
    file.write_text(changed)
    assert main(["tune", "grip.toml", "--workers", "1"]) == ExitCode.FAILURE
    told = capsys.readouterr()
    assert "the scenario's own: failed" in told.out
    assert "no trial has a mean: a run failed, or gave no number of raises" in told.out
    assert told.err.splitlines() == ["mdms: ValueError: no value"]


def test_a_best_that_fails_on_unseen_seeds_is_not_called_no_better(file, capsys):
    file.write_text(
        FILE.replace("own.py:miss", "own.py:unlucky").replace("seeds = 1", "seeds = [5]")
    )
    assert main(["tune", "grip.toml", "--workers", "1"]) == ExitCode.OK
    told = capsys.readouterr().out
    assert "run again failed" in told
    assert "they cannot be compared: a run failed, or gave no number" in told
    assert "no trial is better" not in told


def test_the_best_values_are_told_as_simulate_takes_them(file, capsys):
    vary = """[vary]
parcel.box.mass_kg = { uniform = [1.0, 3.0] }
truth.cell.friction = { uniform = [0.1, 0.6] }
parcel.box.centre_of_mass_m.0 = { uniform = [-0.01, 0.01] }
cell.pwm_steps = { integers = [100, 1_000_000] }
"""
    text = FILE.split("[vary]", maxsplit=1)[0] + vary
    # A row has no host, and so no truth beside a belief.
    table = '{ scenario = "array18", run.duration_s = 0.1, cell.pwm_steps = 1000000 }'
    text = text.replace('"paper-fig8"', table).replace("trials = 12", "trials = 1")
    file.write_text(text)
    main(["tune", "grip.toml", "--workers", "1"])
    told = capsys.readouterr().out
    assert "    truth.cell.friction = 0.3\n" in told
    words = told.split()
    options = [word for word in words if "=" in word and word != "="]
    assert options == [
        *("parcel.0.mass_kg=2", "parcel.0.centre_of_mass_m.0=0", "cell.pwm_steps=1000000"),
    ]
    load_scenario("array18", options)


def test_a_row_whose_chance_is_tuned_has_many_seeds(file):
    file.write_text(
        FILE.replace("seeds = 1", "seeds = 2")
        .replace('"cell.friction"', '"cell.motor_spread"', 1)
        .replace("[0.1, 0.6]", "[0.0, 0.1]")
    )
    assert len(read_tuning(file).design.seeds) == 2


def test_ctrl_c_in_a_later_batch_does_not_count_that_batch_alone(file, capsys, monkeypatch):
    designs = []

    def interrupted(*arguments, **options):
        designs.append(arguments)
        if len(designs) == 3:
            raise KeyboardInterrupt
        return run_design(*arguments, **options)

    monkeypatch.setattr("mdms_host.cli.simulation.sweep.run_design", interrupted)
    main(["tune", "grip.toml", "--workers", "1"])
    told = capsys.readouterr().err
    assert "mdms: all ended runs are kept in runs/grip; the same command goes on from" in told
    assert len(runs_in(file.parent / "runs" / "grip" / "journal.sqlite")) == 8


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (('minimise = "own.py:miss"', ""), "give minimise or maximise"),
        (("trials = 12", "trials = 0"), "trials is 0, but must be a whole number"),
        (("unseen = 2", "unseen = 1"), "unseen is 1, but must be a whole number, 2 to"),
        (("uniform = [0.1, 0.6]", "uniform = [0.4, 0.6]"), "cell.friction is 0.3 in the scenario"),
        (("uniform = [0.1, 0.6]", "integers = [0, 1]"), "cell.friction is 0.3 in the scenario, wh"),
        (("{ uniform = [0.1, 0.6] }", "[0.1, 0.6]"), "give each key a distribution"),
        (("cell.friction", "cell.fricton"), "cell.fricton has no number in the scenario"),
        (("at_least = 1.0", "least = 1.0"), "but must be { at_least = LOW }"),
        (("at_least = 1.0", "at_least = nan"), "or both, of finite numbers"),
        (("at_least = 1.0", "at_least = true"), "or both, of finite numbers"),
        (("at_least = 1.0", "at_least = 1, at_most = 0"), "at_least 1 above at_most 0, so nothing"),
        (("seeds = 1", "seeds = 1\nseed = -5"), "seed is -5, but must be 0 to 4,294,967,295"),
        (("{ uniform = [0.1, 0.6] }", "5"), "grip.toml: vary.cell.friction is 5, but must be a li"),
        (("[0.1, 0.6]", "[0.1, 'a']"), "vary.cell.friction: uniform(0.1, 'a'): give two finite"),
        (
            ('"cell.friction" = { uniform = [0.1, 0.6] }', "run.seed = { integers = [0, 9] }"),
            "vary: run.seed cannot vary by itself; `seeds` says which seeds are run",
        ),
        (
            ('"cell.friction" = { uniform = [0.1, 0.6] }', "array.columns = { uniform = [9, 12] }"),
            "vary: the first trial cannot be run: array.columns is 10.0, but must be a whole",
        ),
        (("seeds = 1", "seeds = 2"), "seeds: 2 are given, but run.fidelity is 'row', and this one"),
        (("reached =", "speed ="), "'speed' is unknown"),
        (("[vary]", "[varied]"), "varied is not a known key; there are scenario, vary"),
    ],
)
def test_a_file_that_cannot_be_tuned_is_refused(file, change, told, capsys):
    file.write_text(FILE.replace(*change, 1))
    assert main(["tune", "grip.toml", "--workers", "1"]) == ExitCode.USAGE
    error = capsys.readouterr().err
    assert told in error
    assert error.count("grip.toml") == 1
    assert error.count("\n") == 1
