"""Every example runs to its end in virtual time, as it would on hardware."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from mdms_host.cli import main

EXAMPLES = Path(__file__).parents[2] / "examples"
#: The table that some of them share, the file that Python itself runs, sweeps, and a training.
NO_PROGRAMS = {
    *("infeed18.toml", "by_hand.py"),
    *("losses.py", "rolling_ends.py", "squaring.py", "swing.py", "tune18.toml"),
}
PROGRAMS = sorted(
    path.name
    for path in EXAMPLES.iterdir()
    if path.suffix in (".py", ".toml") and path.name not in NO_PROGRAMS
)


def simulated(capsys, name, *options):
    code = main(["simulate", str(name), "--json", *options])
    out, err = capsys.readouterr()
    return code, json.loads(out), err


@pytest.mark.parametrize("name", PROGRAMS)
def test_an_example_does_as_it_says(name, capsys):
    code, figures, err = simulated(capsys, EXAMPLES / name)
    assert (code, figures["fault"]) == (0, None), err
    assert all(goal["reached"] for goal in figures["goals"])
    if "stream" in figures:
        assert figures["stream"]["left"] >= 2
        assert figures["stream"]["wrong"] == figures["stream"]["touches"] == 0


def test_a_box_is_carried_by_hand():
    done = subprocess.run(
        [sys.executable, EXAMPLES / "by_hand.py"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("reached>\n")


def test_54_cells_on_three_buses_sort_all_that_comes(capsys):
    code, figures, _ = simulated(capsys, "sort54", "--set", "task.0.count=2")
    assert code == 0
    assert (figures["stream"]["left"], figures["stream"]["touches"]) == (2, 0)
    assert figures["duration_s"] < 5.0
