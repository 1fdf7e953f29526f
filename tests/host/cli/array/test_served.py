"""The verbs for a real bus, on an array that another process serves."""

import json
import re
import resource
import shutil
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from tests.held_up import until_not_held_up

from mdms_host.can_link.bus_log import read_log
from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode
from mdms_model.run.folder import read_run

pytestmark = pytest.mark.real_time

MDMS = Path(sys.executable).with_name("mdms")
LINE = str(Path(__file__).parents[4] / "examples" / "line" / "table.toml")


@contextmanager
def begun(command):
    """A program that runs meanwhile; a test that fails kills it, and does not wait for its end."""
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as process:
        try:
            yield process
        except BaseException:
            process.kill()
            raise


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """python-can's options for a bus that `mdms serve` runs meanwhile."""
    command = [
        str(MDMS),
        "serve",
        "array18",
        "--name",
        str(tmp_path_factory.mktemp("bus") / "sock"),
        "--tcp",
        "0",
    ]
    with begun(command) as process:
        port = None
        while port is None:
            line = process.stdout.readline()
            assert line, process.stderr.read()
            port = re.search(r"socket://[\d.]+:\d+", line)
        # Nothing has to be waited for as for an adapter that is reset when it is opened.
        yield ("-i", "slcan", "-c", port[0], "-b", "1000000", "--bus-kwargs", "sleep_after_open=0")
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=120) == ExitCode.OK


def run_here(capsys, *arguments):
    """The figures of a run in this process that comes to its end."""
    printed = []

    def run():
        code = main(["run", *arguments, "--json"])
        printed.append(capsys.readouterr())
        return code, printed[-1].err

    code, told = until_not_held_up(run)
    assert code == ExitCode.OK, told
    return json.loads(printed[-1].out)


def test_scan_finds_all_cells(served, capsys):
    assert main(["scan", *served, "--json"]) == ExitCode.OK
    nodes = json.loads(capsys.readouterr().out)["nodes"]
    assert [node["node_id"] for node in nodes] == list(range(1, 19))
    assert {node["identity"]["name"] for node in nodes} == {"MDMS cell"}


def test_status_shows_drives_and_presence(served, capsys):
    assert main(["status", *served, "--json"]) == ExitCode.OK
    shown = json.loads(capsys.readouterr().out)
    counts = ("garbled", "error_frames", "waited", "unsent", "foreign")
    assert shown["link"] == dict.fromkeys(counts, 0)
    cells = shown["cells"]
    assert len(cells) == 18
    assert {cell["drives"][0] for cell in cells} == {"switch on disabled"}
    assert any(cell["presence"] for cell in cells)


#: A host without simulator, compiler and pictures.
BARE = """
import sys
sys.modules.update(dict.fromkeys(("mdms_sim", "mdms_cell", "numba", "matplotlib")))
from mdms_array import extras
from mdms_host.cli import main
extras.find_spec = lambda name: name == "mcap" or None
sys.exit(main(sys.argv[1:]))
"""


def test_run_on_an_array_file_needs_no_simulator_and_keeps_its_record(served, tmp_path):
    array, out = tmp_path / "array.toml", tmp_path / "run"
    array.write_text("[array]\ncolumns = 6\nrows = 3\n")
    # A run that was held up is repeated into its folder.
    kept = ["--out", out, "--force"]
    command = ["run", "array18", *served, "--array", array, *kept, "--limit", "2", "--json"]
    at_rest = ["--set", "motion.field=uniform", "--set", "motion.speed_m_s=0"]
    ran = []

    def run():
        ran.append(
            subprocess.run(
                [sys.executable, "-c", BARE, *map(str, command), *at_rest],
                capture_output=True,
                text=True,
                check=False,
            )
        )
        return ran[-1].returncode, ran[-1].stderr

    code, told = until_not_held_up(run)
    assert code == ExitCode.OK, told
    assert json.loads(ran[-1].stdout)["ending"] == "done"
    assert "no picture without matplotlib" in told
    names = sorted(path.name for path in out.iterdir())
    assert names == [
        *("bus.log", "lichtblick_layout.json", "mdms-cell.dbc", "meta.json", "run.mcap")
    ]
    stored = read_run(out)
    assert stored.figures["node_ids"] == list(range(1, 19))
    assert stored.record.is_belief
    assert np.isfinite(stored.record.estimate[-1]).all()
    assert np.isfinite(stored.record.speed_m_s[-1]).all()
    assert sum(1 for _ in read_log(out / "bus.log")) > 1000
    assert main(["plot", str(out)]) == ExitCode.OK
    assert main(["export", str(out), "--csv", str(tmp_path / "tables")]) == ExitCode.OK


@pytest.mark.slow
def test_run_carries_the_box_stop_finds_all_off_and_serve_keeps_the_truth(tmp_path, capsys):
    out, name = tmp_path / "run", str(tmp_path / "sock")
    command = [str(MDMS), "serve", "array18", "--name", name, "--tcp", "0", "--out", str(out)]
    with begun(command) as process:
        while "slcan" not in process.stdout.readline():
            assert process.poll() is None
        figures = run_here(capsys, "array18", "-i", "mdms", "-c", name, "--limit", "60")
        assert main(["stop", "-i", "mdms", "-c", name]) == ExitCode.OK
        assert capsys.readouterr().out == "18 cells are off\n"
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=120) == ExitCode.OK, process.stderr.read()
    assert figures["ending"] == "done"
    (box,) = figures["parcels"]
    assert box["estimate"]["x_m"] == pytest.approx(0.10, abs=0.01)
    stored = read_run(out)
    assert not stored.record.is_belief
    assert stored.record.pose[-1, 0, 0] == pytest.approx(0.10, abs=0.01)
    assert stored.figures["bus"]["frames"] > 1000
    assert stored.scenario.run.duration_s == stored.record.time_s[-1]
    assert (out / "picture.png").exists()


def test_a_served_table_in_a_line_tells_its_events_as_a_run_does(tmp_path):
    name, state = str(tmp_path / "sock"), str(tmp_path / "state")
    command = [str(MDMS), "serve", LINE, "--name", name, "--modbus", "0", "--state", state]
    with begun(command) as process:
        assert any("connect with" in line for line in iter(process.stdout.readline, ""))
        process.send_signal(signal.SIGINT)
        _, told = process.communicate(timeout=120)
    assert process.returncode == ExitCode.OK
    assert re.match(r" +\d+\.\d{3} s  line: Stopped\n", told), told


def test_run_that_is_terminated_leaves_every_motor_off(served):
    run = [str(MDMS), "run", "array18", *served, "--set", "motion.speed_m_s=0.01", "--limit", "60"]
    with begun(run) as process:
        events = iter(process.stderr.readline, "")
        assert any(line.endswith("  running\n") for line in events)
        process.send_signal(signal.SIGTERM)
        told = process.stderr.read().splitlines()
        assert process.wait(timeout=120) == ExitCode.FAILURE
    assert told[-1] == "mdms: terminated"
    assert any(line.endswith("  stopped") for line in told)
    assert "Traceback" not in "".join(told)


def fill_disk(process):
    """Have files of a program grow no more."""
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (50_000, 50_000))


FULL = "bus.log: cannot be written: File too large; it ends here\n"


def test_run_on_a_disk_that_gets_full_comes_to_its_orderly_end(served, tmp_path):
    out = tmp_path / "run"
    run = [str(MDMS), "run", "array18", *served, *AT_REST, "--out", str(out)]

    def ran():
        shutil.rmtree(out, ignore_errors=True)
        with begun(run) as process:
            told = []
            for line in iter(process.stderr.readline, ""):
                told.append(line)
                if line.endswith("  running\n"):
                    fill_disk(process)
            assert "done after" in process.stdout.read()
            return process.wait(timeout=120), "".join(told)

    code, told = until_not_held_up(ran)
    assert code == ExitCode.FAILURE, told
    assert told.count(FULL) == 1
    assert told.index(FULL) < told.index("  stopped\n")
    assert told.endswith("; only what was written before is there\n")
    assert sum(1 for _ in read_log(out / "bus.log")) > 1000


def test_serve_goes_on_when_its_disk_gets_full(tmp_path, capsys):
    out, name = tmp_path / "run", str(tmp_path / "sock")
    command = [str(MDMS), "serve", "array18", "--name", name, "--out", str(out)]
    with begun(command) as process:
        while "mdms scan" not in process.stdout.readline():
            assert process.poll() is None
        fill_disk(process)
        # A machine that is too busy is reported before.
        assert any(line.endswith(FULL) for line in iter(process.stderr.readline, ""))
        assert main(["stop", "-i", "mdms", "-c", name]) == ExitCode.OK
        assert capsys.readouterr().out == "18 cells are off\n"
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=120) == ExitCode.FAILURE
        assert process.stderr.read().endswith("; only what was written before is there\n")
    assert sum(1 for _ in read_log(out / "bus.log")) > 1000


#: The lower row and a half of the array on one bus, the rest on another.
HALVES = "array.buses=[[1,2,3,4,5,6,7,8,9],[10,11,12,13,14,15,16,17,18]]"
AT_REST = ["--set", "motion.field=uniform", "--set", "motion.speed_m_s=0", "--limit", "1.5"]


@pytest.fixture(scope="module")
def halves(tmp_path_factory):
    """The name of an array on two buses that `mdms serve` runs meanwhile."""
    name = str(tmp_path_factory.mktemp("bus") / "halves")
    command = [str(MDMS), "serve", "array18", "--set", HALVES, "--name", name]
    with begun(command) as process:
        head = "".join(process.stdout.readline() for _ in range(7))
        assert "18 cells on 2 virtual CAN buses" in head, process.stderr.read()
        assert all(f"mdms scan -i mdms -c {name}.{bus}\n" in head for bus in range(2))
        yield name
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=120) == ExitCode.OK


def test_run_drives_cells_on_several_buses(halves, tmp_path, capsys):
    out = tmp_path / "run"
    kept = ["--out", str(out), "--force"]
    command = ["array18", "--set", HALVES, "-i", "mdms", "-c", halves, *kept]
    run_here(capsys, *command, *AT_REST)
    names = [line.split()[1] for line in (out / "bus.log").read_text().splitlines()]
    assert {*names} == {"can0", "can1"}
    assert min(names.count(name) for name in {*names}) > 1000
    assert np.isfinite(read_run(out).record.speed_m_s[-1]).all()


def test_run_takes_the_channels_of_several_buses_from_the_array_file(halves, tmp_path, capsys):
    array = tmp_path / "array.toml"
    # Bus 1 of the served array is bus 0 here.
    cells = "".join(
        f'[[cell]]\nserial = "{number:08X}"\nnode = {(number - 1) % 9 + 1}\nnumber = {number}\n'
        f"bus = {int(number < 10)}\n"
        for number in range(1, 19)
    )
    array.write_text(f"[array]\nchannels = ['{halves}.1', '{halves}.0']\n{cells}")
    ran = run_here(capsys, "array18", "-i", "mdms", "--array", str(array), *AT_REST)
    assert ran["ending"] == "done"
    # Taken for each other, the halves would show the box elsewhere.
    assert ran["parcels"][0]["estimate"]["x_m"] == pytest.approx(-0.10, abs=0.02)
    assert ran["parcels"][0]["estimate"]["y_m"] == pytest.approx(0.0, abs=0.02)


def test_bus_that_is_not_there_is_named(halves, capsys):
    command = ["run", "array18", "--set", HALVES, "-i", "mdms", "-c", f"{halves}x"]
    assert main(command) == ExitCode.NO_DEVICE
    assert f"no bus is served as '{halves}x.0'" in capsys.readouterr().err


def test_other_verbs_are_for_one_bus(halves, capsys):
    assert main(["scan", "-i", "mdms", "-c", f"{halves}.1", "--json"]) == ExitCode.OK
    nodes = json.loads(capsys.readouterr().out)["nodes"]
    assert [node["node_id"] for node in nodes] == list(range(1, 10))
    assert nodes[0]["identity"]["serial"] == 10
