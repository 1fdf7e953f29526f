"""Commands that run for long: log files, reports on request, and after their device is gone."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from mdms_model.run.folder import StoredRun, read_run

pytestmark = [pytest.mark.real_time, pytest.mark.slow]

MDMS = [sys.executable, "-c", "import sys; from mdms_host.entry import main; sys.exit(main())"]
PATIENCE_S = 120
#: A job without an end.
JOB = """
import asyncio

SCENARIO = "array18"

async def main(table):
    while True:
        await table.sleep(1.0)
"""


class Commands:
    """Commands with a runtime folder and a state folder of their own, ended when done."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.environment = os.environ | {
            "XDG_RUNTIME_DIR": str(folder),
            "XDG_STATE_HOME": str(folder / "state"),
        }
        self._begun: list[subprocess.Popen[str]] = []

    def begin(self, *arguments: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [*MDMS, *arguments],
            cwd=self.folder,
            env=self.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            # A service has no terminal.
            start_new_session=True,
        )
        self._begun.append(process)
        return process

    def ask(self, *arguments: object) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [*MDMS, *map(str, arguments)],
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            check=False,
        )

    def serve(self, *options: str) -> subprocess.Popen[str]:
        served = self.begin("serve", "array18", "--name", "kept", *options)
        assert served.stdout is not None
        assert any("slcan" in line for line in iter(served.stdout.readline, ""))
        return served

    def close(self) -> None:
        for process in self._begun:
            process.kill()
            process.communicate()


@pytest.fixture
def commands(tmp_path: Path) -> Iterator[Commands]:
    commands = Commands(tmp_path)
    try:
        yield commands
    finally:
        commands.close()


def until(done: Callable[[], object]) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not done():
        assert time.monotonic() < end_s
        time.sleep(0.05)


def report_of(printed: str) -> StoredRun:
    return read_run(json.loads(printed)["report"])


def test_a_served_table_and_its_host_report_on_request_and_after_the_bus_is_gone(commands) -> None:
    served = commands.serve("--log-dir", "logs")
    (commands.folder / "job.py").write_text(JOB)
    host = commands.begin("run", "job.py", "-i", "mdms", "-c", "kept")
    assert host.stderr is not None
    assert any("running" in line for line in iter(host.stderr.readline, ""))
    asked = commands.ask("report")
    assert (asked.returncode, "several tables run" in asked.stderr) == (2, True)

    asked = commands.ask("report", host.pid, "--json")
    assert asked.returncode == 0, asked.stderr
    of_host = report_of(asked.stdout)
    assert of_host.folder.parent == commands.folder / "state" / "mdms-array" / "reports"
    assert "running" in [event.detail for event in of_host.record.events]
    assert of_host.figures["report"]["link"] is not None

    asked = commands.ask("report", served.pid, "--out", "here", "--json")
    assert asked.returncode == 0, asked.stderr
    of_table = report_of(asked.stdout)
    assert of_table.folder == commands.folder / "here"
    assert not of_table.record.is_belief
    assert any("a client has come" in event.detail for event in of_table.record.events)

    served.kill()
    _, said = host.communicate(timeout=PATIENCE_S)
    assert host.returncode == 4
    (path,) = {*of_host.folder.parent.iterdir()} - {of_host.folder}
    assert f"the last minute is in {path}" in said
    after = read_run(path)
    assert "gone" in after.figures["reason"]
    assert after.figures["report"]["findings"][0]["kind"] == "adapter"
    assert any(event.kind == "link" for event in after.record.events)


def test_sighup_opens_log_files_again_and_sigterm_ends_the_service(commands) -> None:
    served = commands.serve("--log", "all", "--log-dir", "logs")
    events, frames = (commands.folder / "logs" / name for name in ("events.log", "bus.log"))
    assert commands.ask("scan", "-i", "mdms", "-c", "kept").returncode == 0
    until(lambda: events.exists() and "a client has left" in events.read_text())
    until(frames.exists)
    events.rename(events.with_name("events.old"))
    served.send_signal(signal.SIGHUP)
    assert commands.ask("scan", "-i", "mdms", "-c", "kept").returncode == 0
    until(lambda: events.exists() and "a client has left" in events.read_text())
    assert served.poll() is None
    served.send_signal(signal.SIGTERM)
    served.communicate(timeout=PATIENCE_S)
    assert served.returncode == 0
    assert all(line[-2:] in (" R", " T") for line in frames.read_text().splitlines())
