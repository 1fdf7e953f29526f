"""`mdms configure` on arrays, in virtual time: all cells of the demo, and blank ones."""

import json
import tomllib

import pytest
from tests.virtual_array import SimulatedArray, virtual_time

from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode
from mdms_protocol.codecs import cob
from mdms_sim.nodes.python_bank import PythonBank

CELLS = 18
BUS = ("-i", "virtual")


def configure(*arguments):
    return main(["configure", *map(str, arguments), *BUS])


@pytest.fixture
def gains(capsys):
    """Reads the gains of axis 1 by node id."""

    def read():
        assert configure("show", "axis1.gain", "--json") == ExitCode.OK
        return json.loads(capsys.readouterr().out)["settings"][0]["values"]

    return read


def test_array_is_backed_up_changed_and_restored(gains, tmp_path, capsys):
    file = tmp_path / "array.toml"
    with virtual_time(SimulatedArray(PythonBank(range(1, CELLS + 1)))):
        assert configure("dump", file) == ExitCode.OK
        assert len(tomllib.loads(file.read_text())["cell"]) == CELLS
        assert configure("set", "gain=12", "--node", "3", "5-7", "--save") == ExitCode.OK
        printed = capsys.readouterr().out
        assert "8 settings written and verified; stored on node 3, 5-7" in printed
        assert [node for node, gain in gains().items() if gain == 12.0] == ["3", "5", "6", "7"]
        assert configure("load", file, "--yes", "--save") == ExitCode.OK
        assert "axis1.gain: 12 -> 13 V s/m  (node 3, 5-7)" in capsys.readouterr().out
        assert set(gains().values()) == {13.0}


def test_blank_cells_are_found_and_numbered_by_their_serial_numbers(capsys):
    """All cells answer each question of the scan at once."""
    with virtual_time(SimulatedArray(PythonBank([cob.NODE_NONE] * 6), "array.rows=1")):
        assert configure("show") == ExitCode.NO_DEVICE
        assert "mdms configure assign" in capsys.readouterr().err
        assert configure("assign", "--first", "21") == ExitCode.OK
        lines = capsys.readouterr().out.splitlines()
        assert lines[:6] == [f"{serial:08X}: blank -> node {20 + serial}" for serial in range(1, 7)]
        assert configure("show", "gain", "--node", "21-26") == ExitCode.OK
