"""A signal ends a run in one line and leaves nothing behind."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode

MDMS = Path(sys.executable).with_name("mdms")
#: Hours of virtual time; the test ends it.
LONG = ("--set", "run.duration_s=1e4", "--set", "array.columns=3", "--set", "array.rows=1")


def wait_for_frames(process, folder):
    """Until the run has begun to write its bus log."""
    while not any(path.stat().st_size for path in folder.glob(".run.*/bus.log")):
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.01)


@pytest.mark.parametrize(
    ("number", "nodes", "ends"),
    [
        (signal.SIGINT, "cpython", (130, b"mdms: interrupted\n")),
        (signal.SIGINT, "micropython", (130, b"mdms: interrupted\n")),
        (signal.SIGTERM, "cpython", (ExitCode.FAILURE, b"mdms: terminated\n")),
        (signal.SIGHUP, "cpython", (ExitCode.FAILURE, b"mdms: terminated\n")),
    ],
)
def test_run_that_is_ended_by_a_signal_is_told_in_one_line_and_not_kept(
    tmp_path, number, nodes, ends
):
    command = [str(MDMS), "simulate", "array18", *LONG, "--nodes", nodes, "--out", "run"]
    # The caller of the tests may ignore the signal (nohup does), and a child inherits that.
    before = signal.signal(number, signal.SIG_DFL)
    try:
        process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE)
    finally:
        signal.signal(number, before)
    with process:
        try:
            wait_for_frames(process, tmp_path)
            process.send_signal(number)
            _, told = process.communicate(timeout=120)
        finally:
            process.kill()
    assert (process.returncode, told) == ends
    assert list(tmp_path.iterdir()) == []


def test_killed_run_leaves_the_old_one_whole_and_the_next_clears_up(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    short = ["simulate", "paper-fig7", "--set", "run.duration_s=0.1", "--out", "run"]
    assert main(short) == ExitCode.OK
    before = {path.name: path.read_bytes() for path in (tmp_path / "run").iterdir()}
    command = [str(MDMS), "simulate", "array18", *LONG, "--out", "run", "--force"]
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE) as process:
        wait_for_frames(process, tmp_path)
        process.kill()
    assert {path.name: path.read_bytes() for path in (tmp_path / "run").iterdir()} == before
    assert len(list(tmp_path.iterdir())) == 2
    assert main(short) == ExitCode.OK
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_a_service_under_nohup_heeds_no_hangup(monkeypatch):
    heeded = []
    monkeypatch.setattr(
        "mdms_host.cli.simulation.serve._serve",
        lambda *_, **__: (heeded.append(signal.getsignal(signal.SIGHUP)), None),
    )
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert main(["serve", "array18"]) == ExitCode.OK
    finally:
        signal.signal(signal.SIGHUP, before)
    assert heeded == [signal.SIG_IGN]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_service_that_is_ended_before_its_folder_is_written_says_so(
    tmp_path, monkeypatch, capsys, number
):
    ends = {signal.SIGTERM: (ExitCode.FAILURE, "terminated"), signal.SIGINT: (130, "interrupted")}
    for name in ("_serve", "_serve_and_keep"):
        monkeypatch.setattr(
            f"mdms_host.cli.simulation.serve.{name}", lambda *_, **__: signal.raise_signal(number)
        )
    assert main(["serve", "array18"]) == ExitCode.OK
    assert capsys.readouterr().err == ""
    code, word = ends[number]
    assert main(["serve", "array18", "--out", str(tmp_path / "run")]) == code
    assert capsys.readouterr().err == f"mdms: {word}\n"
