"""`mdms configure` on served arrays: all cells of the demo, a serial line, blank cells."""

import json
import tomllib

import pytest
from tests.system.serving import serving

from mdms_host.cli import main
from mdms_host.cli.exits import Exit
from mdms_protocol import cob
from mdms_sim.nodes.python_bank import PythonBank

#: One array is served to all.
pytestmark = pytest.mark.xdist_group("configure")

CELLS = 18


def configure(array, *arguments):
    return array.run("mdms", "configure", *arguments, "-i", "mdms", "-c", array.channel)


def gains(array):
    document = json.loads(configure(array, "show", "axis1.gain", "--json").stdout)
    return document["settings"][0]["values"]


def test_array_is_backed_up_changed_and_restored(served, tmp_path):
    file = tmp_path / "array.toml"
    assert configure(served, "dump", file).returncode == 0
    assert len(tomllib.loads(file.read_text())["cell"]) == CELLS
    done = configure(served, "set", "gain=12", "--node", "3", "5-7", "--save")
    assert done.returncode == 0, done.stderr
    assert "8 settings written and verified; stored on node 3, 5-7" in done.stdout
    assert [node for node, gain in gains(served).items() if gain == 12.0] == ["3", "5", "6", "7"]
    done = configure(served, "load", file, "--yes", "--save")
    assert "axis1.gain: 12 -> 13 V s/m  (node 3, 5-7)" in done.stdout
    assert set(gains(served).values()) == {13.0}


def test_settings_are_changed_over_a_serial_line(served):
    door = ("-i", "slcan", "-c", served.device, "-b", "1000000")
    done = served.run("mdms", "configure", "set", "axis2.stall_time=0.4", "--node", "18", *door)
    assert done.returncode == 0, done.stderr
    assert done.stdout == (
        "axis2.stall_time: 0.08 -> 0.4 s  (node 18)\n1 settings written and verified\n"
    )


@pytest.mark.slow
def test_blank_cells_are_found_and_numbered_by_their_serial_numbers(tmp_path, capsys):
    """All cells answer each question of the scan at once."""
    channel = str(tmp_path / "bus.sock")
    with serving(PythonBank([cob.NODE_NONE] * CELLS), channel):
        bus = ("-i", "mdms", "-c", channel)
        assert main(["configure", "show", *bus]) == Exit.NO_DEVICE
        assert "mdms configure assign" in capsys.readouterr().err
        assert main(["configure", "assign", "--first", "21", *bus]) == Exit.OK
        lines = capsys.readouterr().out.splitlines()
        assert lines[:CELLS] == [
            f"{serial:08X}: blank -> node {20 + serial}" for serial in range(1, CELLS + 1)
        ]
        assert main(["configure", "show", "gain", "--node", "21-38", *bus]) == Exit.OK
