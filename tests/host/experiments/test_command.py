"""`mdms sweep`: files, tables, pictures, and how it ends."""

import json
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pandas
import pytest
from tests.conftest import MDMS
from tests.host.experiments.one_process import run_here

from mdms_array import Progress
from mdms_host.cli import main
from mdms_host.cli.exits import INTERRUPTED, ExitCode
from mdms_host.cli.simulation.sweep import progress_text

FILE = """
seeds = 2
measures = ["slipping_share", "parcels.0.x_m", "own.py:end_m"]

[scenario]
scenario = "paper-fig8"
run = { duration_s = 0.2, step_s = 0.01 }
cell = { motor_spread = 0.01 }

[over]
cell.friction = { from = 0.2, to = 0.3, count = 2 }
"parcel.box.mass_kg" = [1.0, 2.0]

[[plot]]
file = "end.png"
measure = "end_m"
over = ["cell.friction"]
"""


@pytest.fixture
def file(tmp_path, monkeypatch):
    """A sweep file with a measure of its own beside it."""
    run_here(monkeypatch)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.py").write_text("def end_m(run): return run.parcels['box'].true_pose[0]\n")
    path = tmp_path / "fig8.toml"
    path.write_text(FILE)
    return path


def test_a_sweep_leaves_tables_a_summary_and_pictures(file, tmp_path, capsys):
    assert main(["sweep", "fig8.toml", "--workers", "1"]) == ExitCode.OK
    shown = capsys.readouterr().out
    # A row has no host.
    assert "belief" not in shown
    assert "8 runs, 0 failed: runs/fig8/table.csv" in shown
    folder = tmp_path / "runs" / "fig8"
    assert {path.name for path in folder.iterdir()} == {
        *("journal.sqlite", "table.csv", "table.parquet", "summary.csv", "end.png")
    }
    table = pandas.read_csv(folder / "table.csv")
    assert [*table["cell.friction"]] == [0.2, 0.2, 0.2, 0.2, 0.3, 0.3, 0.3, 0.3]
    assert (table["end_m"] == table["parcels.0.x_m"]).all()
    # All is there: nothing is run again.
    assert main(["sweep", "fig8.toml", "--json"]) == ExitCode.OK
    figures = json.loads(capsys.readouterr().out)
    assert (figures["runs"], len(figures["summary"])) == (8, 4)
    assert (pandas.read_csv(folder / "table.csv")["started"] == table["started"]).all()

    assert main(["sweep", "fig8.toml", "--again", "3"]) == ExitCode.OK
    assert "row 3 comes out the same" in capsys.readouterr().out
    assert (folder / "again-3" / "run.mcap").is_file()
    assert main(["sweep", "fig8.toml", "--again", "9"]) == ExitCode.USAGE
    assert "--again 9: the table has no such row" in capsys.readouterr().err


def test_what_a_file_of_measures_prints_keeps_out_of_json(file, capsys):
    text = "print('loaded')\ndef end_m(run):\n    print('run')\n    return 1.0\n"
    file.with_name("own.py").write_text(text)
    # One run here: those of workers print to stderr.
    assert main(["sweep", "fig8.toml", "--workers", "1"]) == ExitCode.OK
    capsys.readouterr()
    for more in ([], ["--again", "3"]):
        assert main(["sweep", "fig8.toml", "--json", *more]) == ExitCode.OK
        json.loads(capsys.readouterr().out)


def test_a_row_that_comes_out_otherwise_is_an_error(file, tmp_path, capsys):
    assert main(["sweep", "fig8.toml", "--workers", "1"]) == ExitCode.OK
    with sqlite3.connect(tmp_path / "runs" / "fig8" / "journal.sqlite") as journal:
        text = "substr(columns, instr(columns, 'record_sha256') + 17, 4)"
        journal.execute(f"UPDATE runs SET columns = replace(columns, {text}, 'abcd')")
    journal.close()
    assert main(["sweep", "fig8.toml", "--again", "1"]) == ExitCode.FAILURE
    assert "row 1 comes out otherwise: record_sha256 was abcd" in capsys.readouterr().err


def test_again_refuses_what_it_does_not_follow_and_makes_nothing(file, tmp_path, capsys):
    again = ["sweep", "fig8.toml", "--again", "1"]
    for more, told in (
        (["--workers", "2"], "--workers: --again repeats one run here, with its record; leave"),
        (["--cluster", "x"], "--cluster: --again repeats"),
        (["--records"], "--records: --again repeats"),
        (["--out", "fgi8"], "fgi8: no such sweep: it has no journal.sqlite; see --out"),
    ):
        assert main([*again, *more]) == ExitCode.USAGE
        assert told in capsys.readouterr().err
    assert {path.name for path in tmp_path.iterdir()} == {"own.py", "fig8.toml"}


@pytest.mark.parametrize("name", ["summary.csv", "end.png"])
def test_a_file_that_the_disk_does_not_take_is_named(file, tmp_path, capsys, name):
    assert main(["sweep", "fig8.toml", "--workers", "1"]) == ExitCode.OK
    (tmp_path / "runs" / "fig8" / name).unlink()
    (tmp_path / "runs" / "fig8" / name).mkdir()
    assert main(["sweep", "fig8.toml", "--workers", "1"]) == ExitCode.FAILURE
    assert f"runs/fig8/{name}: cannot be written: Is a directory" in capsys.readouterr().err


def test_again_overwrites_no_other_run(file, tmp_path, capsys):
    again = ["sweep", "fig8.toml", "--again", "1"]
    assert main(["sweep", "fig8.toml", "--workers", "1"]) == ExitCode.OK
    assert main(again) == ExitCode.OK
    assert main(again) == ExitCode.OK
    kept = (tmp_path / "runs" / "fig8" / "again-1" / "run.mcap").read_bytes()
    file.write_text(FILE.replace("from = 0.2", "from = 0.25"))
    assert main(["sweep", "fig8.toml", "--workers", "1"]) == ExitCode.OK
    assert main(again) == ExitCode.USAGE
    told = "again-1: holds another run, from before the sweep was changed; rename or remove it"
    assert told in capsys.readouterr().err
    assert (tmp_path / "runs" / "fig8" / "again-1" / "run.mcap").read_bytes() == kept


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("seeds = 2", "seeds = 0"), "seeds is 0, but must be a whole number, 1 to 1,000,000"),
        (("seeds = 2", "seeds = 2.5"), "seeds is 2.5, but must be a number of runs, or a list"),
        (("seeds = 2", "seed = 'a'"), "seed is 'a', but must be a whole number"),
        (("seeds = 2", "repeats = 2"), "repeats is not a known key; there are scenario, over"),
        (("count = 2", "count = 1"), "over.cell.friction.count is 1, but must be a whole number"),
        (("to = 0.3", "to = 0.1"), "give two finite numbers, the lower one first"),
        (("[1.0, 2.0]", "{ normal = [1, 2] }"), "mass_kg is 2.0 and has nothing inside to set"),
        (("[1.0, 2.0]", "{ uniform = [1] }"), "must be a list of values, { from = LOW"),
        (("[1.0, 2.0]", "{}"), "over.parcel.box.mass_kg is {}, but must be a list"),
        (("count = 2", "count = 2, log = 'no'"), "log is 'no', but must be true or false"),
        (("[1.0, 2.0]", "3.0"), "over.parcel.box.mass_kg is 3.0, but must be a list"),
        (("paper-fig8", "paper-fig80"), "paper-fig80: no such scenario file"),
        (("own.py:end_m", "own.py:start_m"), "own.py: has no function 'start_m'"),
        (("own.py:end_m", "none.py:end_m"), "none.py: cannot be read: No such file"),
        (("cell.friction =", "cell.fricton ="), "cell.fricton is not a known key; did you mean"),
        (
            ("[over]", "[over]\n'cell.friction' = [0.1]"),
            "over: 'cell.friction' in quotes and cell.friction without set the same value",
        ),
        (
            ("[over]", "[over]\n'parcel.0.mass_kg' = [3.0]"),
            "parcel.0.mass_kg and parcel.box.mass_kg set the same value; give one",
        ),
        (("[over]", "[over"), "not valid TOML"),
        (('file = "end.png"', ""), "must have file"),
        (
            ('file = "end.png"', 'file = "end.xyz"'),
            "plot.file is 'end.xyz': .xyz: nothing is drawn",
        ),
        (('file = "end.png"', 'file = ""'), "plot.file is '', but must be a name such as"),
        (('measure = "end_m"', 'measure = "end"'), "measure of end.png is ['end'], but the sweep"),
        (('over = ["cell.friction"]', "over = 3"), "over of end.png is 3, but the sweep has cell."),
        (('over = ["cell.friction"]', 'over = ["cell"]'), "over of end.png is ['cell'], but the"),
        (
            ("[over]", "[over]\nscenario = ['paper-fig7', 'paper-fig8']"),
            "scenario is 'paper-fig7', but no key changes which scenario a run begins with",
        ),
        (("parcel.box", "parcel.bx"), "no parcel has that name; there are box"),
    ],
)
def test_a_file_that_cannot_be_swept_is_refused(file, change, told, capsys):
    file.write_text(FILE.replace(*change))
    assert main(["sweep", "fig8.toml", "--workers", "1"]) == ExitCode.USAGE
    error = capsys.readouterr().err
    assert told in error
    assert error.startswith("mdms: ")
    assert error.count("\n") == 1


def test_arguments_that_cannot_be_are_refused(file, capsys):
    assert main(["sweep", "none.toml"]) == ExitCode.USAGE
    assert main(["sweep", "fig8.toml", "--workers", "0"]) == ExitCode.USAGE
    assert main(["sweep", "fig8.toml", "--workers", "1", "--cluster", "x"]) == ExitCode.USAGE
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(": ", 1)[1] for line in lines] == [
        "none.toml: cannot be read: No such file or directory",
        "workers is 0, but must be a whole number, 1 to 1,000,000",
        "--workers: the cluster has its own; leave one out",
    ]


def test_a_sweep_of_which_every_run_fails_ends_with_1(file, capsys):
    (file.parent / "own.py").write_text("def end_m(run): raise ValueError('no end')\n")
    assert main(["sweep", "fig8.toml", "--workers", "1"]) == ExitCode.FAILURE
    told = capsys.readouterr()
    assert "mdms: ValueError: no end" in told.err
    # There is no picture, and no line for one.
    assert told.out.endswith(f"8 failed: {Path('runs', 'fig8', 'table.csv')}\n")
    assert main(["sweep", "fig8.toml", "--again", "2"]) == ExitCode.FAILURE
    assert "row 2 fails again: ValueError: no end" in capsys.readouterr().out


def test_a_sweep_without_one_of_its_pictures_ends_with_1(file, tmp_path, capsys):
    file.write_text(
        FILE.replace('"own.py', '"bus_load", "own.py')
        + '[[plot]]\nfile = "load.png"\nmeasure = "bus_load"\n'
    )
    assert main(["sweep", "fig8.toml", "--workers", "1"]) == ExitCode.FAILURE
    assert "load.png: bus_load has no numbers to draw; there are" in capsys.readouterr().err
    assert (tmp_path / "runs" / "fig8" / "end.png").is_file()


def test_a_sweep_without_a_picture_ends_with_the_line_of_its_table(file, capsys):
    file.write_text(
        FILE.partition("[[plot]]")[0].replace('"slipping_share", "parcels.0.x_m", ', "")
    )
    file.with_name("own.py").write_text("def end_m(run): return None\n")
    assert main(["sweep", "fig8.toml", "--workers", "1"]) == ExitCode.OK
    assert capsys.readouterr().out.endswith("8 runs, 0 failed: runs/fig8/table.csv\n")


def test_a_file_of_measures_that_ends_its_process_is_refused(file, capsys):
    (file.parent / "own.py").write_text("raise SystemExit(0)\n")
    assert main(["sweep", "fig8.toml", "--workers", "1"]) == ExitCode.USAGE
    assert "own.py: SystemExit: 0" in capsys.readouterr().err


def test_a_file_of_measures_imports_what_lies_beside_it(file, monkeypatch, capsys):
    # What it adds to the path is undone.
    monkeypatch.setattr("sys.path", [*sys.path])
    file.with_name("own_places.py").write_text("def x_m(run): return run.figures['parcels'][0]")
    file.with_name("own.py").write_text(
        "from own_places import x_m\n"
        "def end_m(run):\n    import own_places\n    return own_places.x_m(run)['x_m']\n"
    )
    assert main(["sweep", "fig8.toml", "--workers", "1"]) == ExitCode.OK
    assert "8 runs, 0 failed" in capsys.readouterr().out


@pytest.mark.slow
def test_ctrl_c_keeps_finished_runs_and_the_same_command_goes_on(file, tmp_path):
    file.write_text(FILE.replace("seeds = 2", "seeds = 500"))
    command = [str(MDMS), "sweep", "fig8.toml", "--workers", "2"]
    journal = tmp_path / "runs" / "fig8" / "journal.sqlite"
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path
    ) as process:
        while process.poll() is None and count(journal) < 3:
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        _, error = process.communicate(timeout=60)
    assert process.returncode == INTERRUPTED
    first, second = error.splitlines()
    kept = int(first.split()[1])
    assert first.endswith("runs are kept in runs/fig8; the same command goes on from there")
    assert second == "mdms: interrupted"
    assert 3 <= kept < 2000
    assert len(pandas.read_csv(journal.with_name("table.csv"))) == kept == count(journal)
    file.write_text(FILE.replace("seeds = 2", "seeds = 4"))
    assert main(["sweep", "fig8.toml", "--workers", "1"]) == ExitCode.OK


def count(journal):
    if not journal.exists():
        return 0
    try:
        opened = sqlite3.connect(f"file:{journal}?mode=ro", uri=True)
        try:
            return opened.execute("SELECT count(*) FROM runs").fetchone()[0]
        finally:
            opened.close()
    except sqlite3.Error:
        return 0


def test_progress_is_a_line_with_rate_time_left_and_failed_share():
    assert progress_text(Progress(400)) == "0 of 400 runs"
    state = Progress(400, done=100, failed=5, kept=0, rate_per_s=2.5, left_s=119.6)
    assert progress_text(state) == "100 of 400 runs, 2.5 a second, 2:00 left, 5 % failed"
