"""`mdms run` when its way to the bus ends before the run does."""

import errno
import json
import os
import resource
from pathlib import Path

import numpy as np
import pytest
from tests.host.motion.believing import beliefs

from mdms_array import operation
from mdms_host.can_link.bus_log import read_log
from mdms_host.can_link.link import DeviceGoneError, LinkCounts
from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode
from mdms_host.coordination.operation import Ending, Operation
from mdms_model.run.folder import read_run
from mdms_model.scenario.file import load_scenario


@pytest.fixture
def on_a_bus_that_ends(monkeypatch, request):
    """Runs the verb on a bus whose device is gone after three polls."""

    def operate(coordinator, _link, _clock, _limit_s, _on_event, *, participant, **_others):
        for poll in range(3):
            (participant or coordinator).poll(0.05 * poll)
        raise DeviceGoneError("the CAN device is gone: unplugged")

    monkeypatch.setattr(operation, "operate", operate)

    def run(*more):
        # Without a run folder nothing is kept, and no report is written.
        log = () if "--out" in more else ("--log", "none")
        channel = ["-i", "virtual", "-c", request.node.name]
        return main(["run", "array18", *channel, "--json", *log, *more])

    return run


def test_device_that_goes_away_is_told_as_such(on_a_bus_that_ends, capsys):
    assert on_a_bus_that_ends() == ExitCode.NO_DEVICE
    printed = capsys.readouterr()
    assert json.loads(printed.out)["ending"] == "device gone"
    assert printed.err == "mdms: the CAN device is gone: unplugged\n"


def test_sightings_until_then_are_kept(on_a_bus_that_ends, tmp_path):
    assert on_a_bus_that_ends("--out", str(tmp_path / "run")) == ExitCode.NO_DEVICE
    stored = read_run(tmp_path / "run")
    assert stored.figures["fault"] == "the CAN device is gone: unplugged"
    assert stored.record.time_s.tolist() == [0.0, 0.05, 0.1]
    # Simulated again, the folder has the time that was given.
    assert stored.scenario.run == load_scenario("array18").run
    assert (tmp_path / "run" / "bus.log").read_text().count("77F#05") == 2


LOG_BYTES = 2000
AT_REST = ("--set", "motion.field=uniform", "--set", "motion.speed_m_s=0")


@pytest.fixture
def on_a_full_disk(monkeypatch, tmp_path):
    """Runs the verb with a disk that takes `LOG_BYTES` a file; `more` after the run, if given."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)

    def run(more=LOG_BYTES):
        def operate(*_, participant, **_others):
            resource.setrlimit(resource.RLIMIT_FSIZE, (LOG_BYTES, before[1]))
            for poll in range(1000):
                participant.poll(0.05 * poll)
            resource.setrlimit(resource.RLIMIT_FSIZE, (more, before[1]))
            return Operation(Ending.DONE, 50.0, None, LinkCounts(0, 0, 0, 0))

        monkeypatch.setattr(operation, "operate", operate)
        channel = ("-i", "virtual", "-c", "full")
        try:
            return main(["run", "array18", *channel, "--out", str(tmp_path / "run"), *AT_REST])
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)

    return run


def logged(folder):
    """The number of frames in the bus log of a folder, which has whole lines alone."""
    assert (folder / "bus.log").read_text().endswith("\n")
    return len(list(read_log(folder / "bus.log")))


def test_a_full_disk_ends_no_run_and_leaves_what_it_took(on_a_full_disk, tmp_path, capsys):
    assert on_a_full_disk() == ExitCode.FAILURE
    told = capsys.readouterr()
    assert told.out == "18 cells carry and turn a box: done after 50.0 s\n"
    run = tmp_path / "run"
    assert told.err.splitlines() == [
        f"mdms: {run / 'bus.log'}: cannot be written: File too large; it ends here",
        f"mdms: {run}: cannot be written: File too large; only what was written before is there",
    ]
    assert logged(run) > 10
    assert not (run / "meta.json").exists()


@pytest.mark.parametrize(
    ("ending", "code"), [(Ending.DONE, ExitCode.USAGE), (Ending.FAULT, ExitCode.NODE_FAULT)]
)
def test_a_run_that_cannot_take_its_place_ends_as_it_went_and_is_kept(
    monkeypatch, tmp_path, capsys, ending, code
):
    def operate(*_, participant, **_others):
        participant.poll(0.0)
        fault = "jammed" if ending is Ending.FAULT else None
        return Operation(ending, 1.0, fault, LinkCounts(0, 0, 0, 0))

    def refused(path, _target):
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(operation, "operate", operate)
    monkeypatch.setattr(Path, "rename", refused)
    run, channel = tmp_path / "run", ("-i", "virtual", "-c", "denied")
    assert main(["run", "array18", *channel, "--out", str(run), *AT_REST]) == code
    told = capsys.readouterr()
    assert "after 1.0 s" in told.out
    partial = tmp_path / f".run.{os.getpid()}.partial"
    assert (
        f"mdms: {run}: cannot be written: Permission denied; what was written is in {partial}\n"
        in told.err
    )
    assert read_run(partial).figures["ending"] == str(ending)


def test_a_disk_that_has_room_again_takes_the_rest_of_the_folder(on_a_full_disk, tmp_path, capsys):
    assert on_a_full_disk(more=resource.RLIM_INFINITY) == ExitCode.OK
    assert capsys.readouterr().err.count("it ends here") == 1
    stored = read_run(tmp_path / "run")
    assert stored.figures["ending"] == "done"
    assert stored.scenario.run.duration_s == stored.record.time_s[-1] > 40.0
    assert 10 < logged(tmp_path / "run") < 100


@pytest.mark.compiles
@pytest.mark.parametrize(
    "case",
    [
        (
            "table.parcels[7]",
            ExitCode.FAILURE,
            "the program failed: IndexError: tuple index out of ",
        ),
        (
            "table['bag']",
            ExitCode.TIME_LIMIT,
            "the program was broken off: no parcel 'bag' is on the",
        ),
        (
            "await table.sleep(99)",
            ExitCode.TIME_LIMIT,
            "not come to its end: it waits in main (program.p",
        ),
        (
            "try:\n        await table.sleep(99)\n    finally:\n        raise OSError('no room')",
            ExitCode.FAILURE,
            "the program failed as the run ended: OSError: no room, in main (program.py, line 6)",
        ),
    ],
)
def test_a_program_that_fails_or_waits_ends_with_its_message_and_code(
    case, tmp_path, monkeypatch, capsys
):
    does, code, told = case

    def operate(coordinator, _link, clock, *_, **_others):
        pose = {"box": np.array([-0.1, 0.0, 0.0])}
        for _ in range(50):
            coordinator.program.references_m_s(
                beliefs(pose, coordinator.tracker.parcels.values()), 0.01
            )
        ending = Ending.TIME_LIMIT if coordinator.stuck is None else Ending.STUCK
        return Operation(ending, 0.5, None, LinkCounts(0, 0, 0, 0))

    monkeypatch.setattr(operation, "operate", operate)
    (tmp_path / "table.toml").write_text("scenario = 'array18'\n[motion]\nfield = 'program'\n")
    program = tmp_path / "program.py"
    program.write_text(f"SCENARIO = 'table.toml'\nasync def main(table):\n    {does}\n")
    assert main(["run", str(program), "-i", "virtual", "-c", "programs", "--json"]) == code
    assert told in capsys.readouterr().err


def test_folder_of_somebody_else_is_not_touched_and_no_bus_opened(on_a_bus_that_ends, tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    assert on_a_bus_that_ends("--out", str(tmp_path)) == ExitCode.USAGE
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[array]\nrows = 0\n", "array.rows is 0, but must be at least 1"),
        (
            "[array]\ncolumns = 5\nrows = 3\n[[cell]]\nserial = '1'\nnode = 1\n",
            "number 2 is missing",
        ),
        ("[array]\ncolumns = 1\nrows = 1\n", "parcel.0.x_m is -0.1, which puts the centre of mass"),
    ],
)
def test_array_file_that_does_not_do_is_refused(on_a_bus_that_ends, tmp_path, capsys, text, told):
    path = tmp_path / "array.toml"
    path.write_text(text)
    assert on_a_bus_that_ends("--array", str(path)) == ExitCode.USAGE
    message = capsys.readouterr().err
    assert told in message
    assert str(path) in message
    assert message.count("\n") == 1


STOP = '[array]\ncolumns = 6\nrows = 3\n\n[stop]\nform = "short"\nmass_kg = 5.0\nspeed_m_s = 0.4\n'
SLOW = ("--set", "motion.speed_m_s=0.4")


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        (
            (*SLOW, "--set", "parcel.0.mass_kg=5.1"),
            "parcel.0.mass_kg is 5.1, but the table's emergency stop holds 5 kg at most",
        ),
        (
            ("--set", "motion.speed_m_s=0.41"),
            "motion.speed_m_s is 0.41, but the table's emergency stop holds parcels at 0.4 m/s at",
        ),
        (
            # Both wheels of a cell at 0.4 m/s make a parcel faster than that.
            ("--set", "motion={field='uniform', speed_m_s=0.8, heading_rad=0.785}"),
            "motion.field moves parcels at [m/s] 0.62, but the table's emergency stop holds",
        ),
    ],
)
def test_parcels_that_the_stop_does_not_hold_are_refused(
    on_a_bus_that_ends, tmp_path, capsys, settings, told
):
    path = tmp_path / "array.toml"
    path.write_text(STOP)
    assert on_a_bus_that_ends("--array", str(path), *settings) == ExitCode.USAGE
    assert f"mdms: {told}" in capsys.readouterr().err


def test_parcels_that_the_stop_holds_run_and_nothing_is_said(on_a_bus_that_ends, tmp_path, capsys):
    path = tmp_path / "array.toml"
    path.write_text(STOP)
    at_the_limit = (*SLOW, "--set", "parcel.0.mass_kg=5")
    assert on_a_bus_that_ends("--array", str(path), *at_the_limit) == ExitCode.NO_DEVICE
    assert capsys.readouterr().err == "mdms: the CAN device is gone: unplugged\n"


def test_an_array_file_that_states_no_stop_is_taken_with_one_warning(
    on_a_bus_that_ends, tmp_path, capsys
):
    path = tmp_path / "array.toml"
    path.write_text("[array]\ncolumns = 6\nrows = 3\n")
    assert on_a_bus_that_ends("--array", str(path)) == ExitCode.NO_DEVICE
    warning, *rest = capsys.readouterr().err.splitlines()
    assert warning.startswith(f"mdms: {path} does not say which parcels the emergency stop holds")
    assert rest == ["mdms: the CAN device is gone: unplugged"]


@pytest.mark.parametrize("more", [(), ("--page",)])
def test_goal_beyond_the_grid_of_the_array_file_is_refused(tmp_path, capsys, more):
    path = tmp_path / "small.toml"
    cells = "".join(f'[[cell]]\nserial = "{n:08X}"\nnode = {n}\n' for n in range(1, 19))
    path.write_text(f"[array]\ncolumns = 6\nrows = 3\n{cells}")
    command = ["run", "array54", "--array", str(path), "-i", "virtual", "-c", "small"]
    assert main([*command, *more]) == ExitCode.USAGE
    message = capsys.readouterr().err
    assert f"on {path}: parcel.0" in message
    assert message.count("\n") == 1
