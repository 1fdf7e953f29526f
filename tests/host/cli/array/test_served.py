"""The verbs for a real bus, on an array that another process serves."""

import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from mdms_host.cli import main
from mdms_host.cli.exits import Exit

pytestmark = pytest.mark.real_time

MDMS = Path(sys.executable).with_name("mdms")


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """python-can's options for a bus that `mdms serve` runs meanwhile."""
    command = [
        str(MDMS),
        "serve",
        "array18",
        "--name",
        str(tmp_path_factory.mktemp("bus") / "sock"),
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        port = None
        while port is None:
            line = process.stdout.readline().decode()
            assert line, process.stderr.read()
            port = re.search(r"socket://[\d.]+:\d+", line)
        yield ("-i", "slcan", "-c", port[0], "-b", "1000000")
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=20) == Exit.OK


def test_scan_finds_all_cells(served, capsys):
    assert main(["scan", *served, "--json"]) == Exit.OK
    nodes = json.loads(capsys.readouterr().out)["nodes"]
    assert [node["node_id"] for node in nodes] == list(range(1, 19))
    assert {node["identity"]["name"] for node in nodes} == {"MDMS cell"}


def test_status_shows_drives_and_presence(served, capsys):
    assert main(["status", *served, "--json"]) == Exit.OK
    cells = json.loads(capsys.readouterr().out)["cells"]
    assert len(cells) == 18
    assert {cell["drives"][0] for cell in cells} == {"switch on disabled"}
    assert any(cell["presence"] for cell in cells)


@pytest.mark.slow
def test_run_carries_the_box_and_stop_finds_all_off(served, capsys):
    assert main(["run", "array18", *served, "--limit", "60", "--json"]) == Exit.OK
    figures = json.loads(capsys.readouterr().out)
    assert figures["ending"] == "done"
    (box,) = figures["parcels"]
    assert box["estimate"]["x_m"] == pytest.approx(0.10, abs=0.01)
    assert main(["stop", *served]) == Exit.OK
    assert capsys.readouterr().out == "18 cells are off\n"


def test_run_that_is_terminated_leaves_every_motor_off(served):
    run = [str(MDMS), "run", "array18", *served, "--set", "motion.speed_m_s=0.01", "--limit", "60"]
    with subprocess.Popen(
        run, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        events = iter(process.stderr.readline, "")
        assert any(line.endswith("  running\n") for line in events)
        process.send_signal(signal.SIGTERM)
        told = process.stderr.read().splitlines()
        assert process.wait(timeout=20) == Exit.FAILURE
    assert told[-1] == "mdms: terminated"
    assert any(line.endswith("  stopped") for line in told)
    assert "Traceback" not in "".join(told)
