"""A served table to rehearse on: empty, commissioned earlier, and with a parcel that tips."""

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.real_time

MDMS = Path(sys.executable).with_name("mdms")
EMPTY = 'title = "Empty"\narray = { columns = 3, rows = 2 }\n'
OFF = "fault=[{kind='push', parcel='box', start_s=0.5, impulse_n_s=[0.0, 4.0]}]"


@pytest.mark.parametrize("nodes", ["cpython", "micropython"])
def test_empty_table_remembers_what_its_cells_have_stored(serve_array, tmp_path, nodes):
    scenario, state = tmp_path / "empty.toml", tmp_path / "state"
    scenario.write_text(EMPTY)
    bus = ("-i", "mdms", "-c", "empty")
    for says in ("axis2.stall_time: 0.08 -> 0.4 s", "nothing to change"):
        options = ("--state", state, "--nodes", nodes)
        table = serve_array(*options, scenario=str(scenario), name="empty")
        change = ("configure", "set", "axis2.stall_time=0.4", "--node", "6", "--save")
        done = table.run("mdms", *change, *bus)
        assert done.returncode == 0, done.stderr
        assert says in done.stdout
        scanned = table.run("mdms", "scan", *bus)
        assert scanned.returncode == 0, scanned.stderr
        assert scanned.stdout.count("MDMS cell") == 6
        table.stop()
        assert table.process.returncode == 0
    first = (state / "cells.json").read_text()
    other = subprocess.run(
        [str(MDMS), "serve", "array18", "--state", str(state)],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert other.returncode == 2
    assert "has the settings of 6 cells, but this table has 18" in other.stderr
    assert (state / "cells.json").read_text() == first


def test_table_goes_on_when_a_parcel_tips(serve_array):
    table = serve_array("--set", OFF, name="tipping")
    line = table.process.stderr.readline()
    assert line.startswith("mdms: box tips at ")
    assert "taken off the table" in line
    scanned = table.run("mdms", "scan", "-i", "mdms", "-c", "tipping")
    assert scanned.returncode == 0, scanned.stderr
    assert scanned.stdout.count("MDMS cell") == 18
    table.stop()
    assert table.process.returncode == 0
