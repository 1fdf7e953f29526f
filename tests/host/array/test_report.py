"""A report is a run folder of the last minute, and names no machine, person or board."""

import json
import re
from argparse import Namespace
from collections.abc import Iterator
from contextlib import ExitStack
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
from tests.host.line.virtual_line import TABLE, VirtualLine
from tests.host.page.bench import unpacked

from mdms_array import report as reports
from mdms_array.anonymous import Anonymous
from mdms_array.host import layout_of
from mdms_host.can_link.bus_log import read_log
from mdms_host.can_link.recent import Recent, RecentFrame
from mdms_host.can_link.recent import unpacked as frames_of
from mdms_host.cli.kept import Kept
from mdms_host.cli.live_array import Watched
from mdms_host.cli.live_page import table_of
from mdms_host.line.packml import Command, State
from mdms_host.page import commands
from mdms_host.programs.table import Table
from mdms_model.arrays import Floats
from mdms_model.run.folder import BUS_LOG, StoredRun, read_run
from mdms_model.scenario.file import load_scenario
from mdms_protocol.codecs import cob
from mdms_protocol.codecs.frame import Frame

pytestmark = pytest.mark.slow

ARRAY = '[[cell]]\nserial = "DEADBEEF"\nnode = 1\n\n[[cell]]\nserial = "DEADBEEE"\nnode = 2\n'
HOME = "/home/jane-doe"


class Aborted(NamedTuple):
    """The report of a line that was aborted, the frames before, when [s], and the true poses."""

    run: StoredRun
    raw: list[RecentFrame]
    time_s: float
    true: Floats


@pytest.fixture(scope="module")
def aborted(tmp_path_factory) -> Iterator[Aborted]:
    """A line that was aborted while it carried parcels."""
    folder = tmp_path_factory.mktemp("kept")
    array_file = folder / "array.toml"
    array_file.write_text(ARRAY)
    arguments = Namespace(log=None, log_dir=folder, out=None)
    scenario = load_scenario(str(TABLE), ["run.fidelity=firmware"])
    with pytest.MonkeyPatch.context() as patch, ExitStack() as opened:
        patch.setenv("XDG_RUNTIME_DIR", str(folder))
        patch.setenv("HOME", HOME)
        patch.setattr("sys.argv", [f"{HOME}/bin/mdms", "run", f"{HOME}/job.py", "--array=a/b.toml"])
        kept = Kept(scenario, layout_of(scenario), arguments, array_file=array_file)
        line = opened.enter_context(VirtualLine(recent=kept.recent))
        watched = Watched(kept, line.slot, scenario)
        seen = SimpleNamespace(machine=line.machine)

        def passes(seconds: float) -> None:
            for _ in range(round(seconds / 0.01)):
                line.pass_s(0.01)
                watched.look(line.now_s(), seen)

        def comes(state: State) -> None:
            while line.state is not state:
                passes(0.01)

        kept.event(0.0, "link", f"jane-doe@plant.example: {HOME}/can.conf: serial 0xDEADBEEF")
        line.command(Command.RESET)
        comes(State.IDLE)
        line.command(Command.START)
        comes(State.EXECUTE)
        kept.event(line.now_s(), "line", "line: Execute")
        passes(3.0)
        time_s, true = line.now_s(), line.simulation.world.pose.copy()
        line.command(Command.ABORT)
        passes(2.0)
        raw = list(frames_of(kept.recent.moment(line.now_s()).frames))
        kept.close()
        (report,) = folder.glob("report-*")
        yield Aborted(read_run(report), raw, time_s, true)


def test_beliefs_wheels_and_sensors_are_those_of_the_run(aborted) -> None:
    run, raw, aborted_s, true = aborted
    record = run.record
    assert record.is_belief
    assert record.time_s[0] == 0.0
    assert np.isfinite(record.estimate[:, 0]).any()
    assert np.abs(record.reference_m_s).max() > 0.05
    assert np.nanmax(np.abs(record.speed_m_s)) > 0.05
    assert record.presence.any()
    sample = int(np.searchsorted(record.time_s, aborted_s - raw[0].time_s)) - 1
    there = np.flatnonzero(np.isfinite(record.estimate[sample, :, 0]))
    assert there.size
    believed = record.estimate[sample, there, :2]
    np.testing.assert_allclose(believed, true[there, :2], atol=0.03)


def test_the_reason_the_states_and_the_load_are_told(aborted) -> None:
    run = aborted.run
    report = run.figures["report"]
    assert run.figures["reason"].startswith("Aborted: Abort by plc")
    assert "line: Execute" in [event.detail for event in run.record.events]
    assert report["frames"] > 10_000
    assert report["load"]["processors"] >= 1
    assert report["load"]["seconds"]
    assert report["written"][:2] == "20"
    assert "seed" not in run.figures


def test_frames_have_their_senders(aborted) -> None:
    run, raw = aborted[:2]
    lines = (run.folder / BUS_LOG).read_text().splitlines()
    until_s = run.figures["report"]["duration_s"] + raw[0].time_s
    assert len(lines) == sum(each.time_s <= until_s for each in raw)
    host = [line for line in lines if " 080#" in line]
    cells = [line for line in lines if re.search(r" 18\d#", line)]
    assert host
    assert cells
    assert all(line.endswith(" T") for line in host)
    assert all(line.endswith(" R") for line in cells)
    assert sum(1 for _ in read_log(run.folder / BUS_LOG)) == len(lines)


def test_the_page_plays_it(aborted) -> None:
    run = aborted.run
    table = table_of(run)
    table.advance(0.0)
    table.do(commands.Seek(table.duration_s - 2.5))
    shown = unpacked(table.description(), table.snapshot(1))
    assert np.isfinite(shown["parcel_believed"]).any()
    assert shown["cell_presence"].any()


def test_it_names_no_machine_person_or_board(aborted) -> None:
    run, raw = aborted[:2]
    meta = json.loads((run.folder / "meta.json").read_text())
    assert meta["provenance"]["command"] == ["mdms", "run", "job.py", "--array=b.toml"]
    assert 'serial = "00000001"' in meta["provenance"]["array"]["text"]
    told = "\n".join(event.detail for event in run.record.events) + json.dumps(meta)
    secrets = ("jane", "DEADBEE", "/home", "deadbee")
    for path in run.folder.iterdir():
        data = path.read_bytes().decode(errors="replace")
        assert not [each for each in secrets if each in data + told], path
    serials = [
        each.frame.data[4:]
        for each in raw
        if each.frame.can_id & ~0x7F == cob.SDO_RESPONSE_BASE
        and each.frame.data[1:4] == b"\x18\x10\x04"
    ]
    assert any(map(any, serials))
    logged = [frame for _, frame in read_log(run.folder / BUS_LOG)]
    kept = [each.data[4:] for each in logged if each.data[1:4] == b"\x18\x10\x04"]
    assert kept
    assert not any(map(any, kept))


async def slow_job(table: Table) -> None:
    await table.sleep(60.0)


def test_it_names_the_recipe_that_runs(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    scenario = load_scenario(str(TABLE), ["run.fidelity=firmware"])
    slow = load_scenario(str(TABLE), ["run.fidelity=firmware", "motion.speed_m_s=0.2"])
    arguments = Namespace(log=None, log_dir=tmp_path, out=None)
    kept = Kept(scenario, layout_of(scenario), arguments)
    with VirtualLine(recent=kept.recent, recipes={"slow": (slow, slow_job)}) as line:
        kept.run_by(line.recipes.jobs, lambda: line.recipes.running)
        watched = Watched(kept, line.slot, scenario)
        line.do("chosen", recipe="slow")
        line.bring_to_execute()
        line.command(Command.STOP)
        line.until_state(State.STOPPED)
        line.command(Command.RESET)
        line.until_state(State.IDLE)
        # The next Start is by another one; the last minute is that of this one.
        line.do("recipe", recipe="table")
        line.command(Command.ABORT)
        line.until_state(State.ABORTED)
        watched.look(line.now_s(), SimpleNamespace(machine=line.machine))
        kept.close()
    (report,) = tmp_path.glob("report-*")
    run = read_run(report)
    provenance = json.loads((report / "meta.json").read_text())["provenance"]
    assert provenance["recipe"] == "slow"
    assert provenance["program"]["file"] == "test_report.py"
    assert run.scenario.motion.speed_m_s == 0.2


def test_a_clock_that_is_set_back_costs_no_new_report(tmp_path, monkeypatch) -> None:
    def write(_snapshot, path):
        path.mkdir()
        return SimpleNamespace(poll=lambda: 0, returncode=0, communicate=lambda: (b"", b""))

    scenario = load_scenario(str(TABLE))
    layout = layout_of(scenario)
    for second in range(reports.MOST_REPORTS):
        (tmp_path / f"report-20260101-0000{second:02d}").mkdir()
    reporter = reports.Reporter(Recent(), (scenario, None), layout, tmp_path, lambda _: None)
    monkeypatch.setattr(reports, "_writer", write)
    for hour in ("12", "11"):
        wall = f"1970-01-01T{hour}:00:00.000+00:00"
        monkeypatch.setattr(reports, "wall_text", lambda wall=wall: wall)
        reporter.begin(0.0, "a fault")
    names = sorted(path.name for path in tmp_path.iterdir())
    assert len(names) == reports.MOST_REPORTS
    assert names[:3] == [
        "report-19700101-110000",
        "report-19700101-120000",
        "report-20260101-000002",
    ]


def test_reports_that_were_broken_off_do_not_fill_the_disk(tmp_path) -> None:
    """As by a power cut: their writers leave the memory that they were to write."""
    scenario = load_scenario(str(TABLE))
    layout = layout_of(scenario)
    for _ in range(reports.MOST_REPORTS + 2):
        # Each in a process of its own.
        reporter = reports.Reporter(Recent(), (scenario, None), layout, tmp_path, print)
        reporter.begin(0.0, "a fault")
        ((writer, _, _),) = reporter._writing
        writer.kill()
        writer.communicate()
    assert len(list(tmp_path.iterdir())) == reports.MOST_REPORTS


@pytest.mark.parametrize(
    ("can_id", "data", "kept"),
    [
        (0x601, "2330300100000020", "2330300100000000"),  # the key, told its size
        (0x601, "0011223344556677", "0000000000000000"),  # a segment of it
        (0x601, "C230300120000000", "C200000000000000"),  # in blocks
        (0x581, "4318100478563412", "4318100400000000"),  # a serial number
        (0x581, "4318100301000200", "4318100301000200"),  # a revision
        (0x581, "8018100400000206", "8018100400000000"),  # an abort of that object
        (0x7E5, "5178563412200000", "5100000000000000"),  # LSS fast scan
        (0x181, "0011223344556677", "0011223344556677"),
    ],
)
def test_frames_lose_serial_numbers_and_keys_alone(can_id, data, kept) -> None:
    frame = Anonymous(()).frame(Frame(can_id, bytes.fromhex(data)))
    assert (frame.can_id, frame.data.hex().upper()) == (can_id, kept)


@pytest.mark.parametrize("home", [HOME, "/"])
def test_texts_keep_what_they_are_about(monkeypatch, home) -> None:
    monkeypatch.setenv("HOME", home)
    text = Anonymous(("plant7", "jane-doe")).text
    assert text(f"{HOME}/plant/can.conf: no such file") == "can.conf: no such file"
    assert text("/dev/ttyACM0 is gone") == "ttyACM0 is gone"
    assert text("0.25 m/s at x = 1.5, 50 1/s, 12345.12345678") == (
        "0.25 m/s at x = 1.5, 50 1/s, 12345.12345678"
    )
    assert text("cell 3 (node 4) has serial number 1A2B3C4D") == (
        "cell 3 (node 4) has serial number 00000001"
    )
    assert text("plant7 at 10.1.2.3, socket://bridge.example:29536, socket://127.0.0.1:1") == (
        "NAME at ADDRESS, socket://ADDRESS:29536, socket://127.0.0.1:1"
    )
