"""`serve` and `run` with their pages, beside each other as two programs are."""

import json
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.host.page.bench import unpacked
from websockets.sync.client import connect

from mdms_host.cli import main
from mdms_host.cli.exits import ExitCode
from mdms_host.page.bus_watch import CellState

MDMS = Path(sys.executable).with_name("mdms")
WITHIN_S = 60.0


@contextmanager
def started(*arguments: str):
    """The address that a verb prints first, while it runs; it ends well when it is interrupted."""
    command = [str(MDMS), *arguments, "--page", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        address = process.stdout.readline().strip()
        assert address.startswith("http://127.0.0.1:"), process.stderr.read()
        yield address
    finally:
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=WITHIN_S)
    # On a busy machine a program may have ended with a fault.
    assert process.returncode in (ExitCode.OK, ExitCode.NODE_FAULT), errors


class Watcher:
    """A client that follows the snapshots."""

    def __init__(self, socket, token: str) -> None:
        self._socket = socket
        self._table: dict = {}
        self.say({"token": token})

    def say(self, message: object) -> None:
        self._socket.send(json.dumps(message))

    def ask(self, command: str) -> dict:
        """The answer to a command."""
        self.say({"id": 1, "command": command})
        end_s = time.monotonic() + WITHIN_S
        while time.monotonic() < end_s:
            message = self._socket.recv(timeout=WITHIN_S)
            if isinstance(message, bytes):
                self.say("seen")
            elif json.loads(message).get("kind") == "answer":
                return json.loads(message)
        raise AssertionError("it was never answered")

    def until(self, holds) -> None:
        """Until it holds of a snapshot and its table."""
        end_s = time.monotonic() + WITHIN_S
        while time.monotonic() < end_s:
            message = self._socket.recv(timeout=WITHIN_S)
            if isinstance(message, bytes):
                self.say("seen")
                shown = unpacked(self._table, message)
                if holds(self._table["phases"][shown["phase"][0]], shown):
                    return
            elif json.loads(message)["kind"] == "table":
                self._table = json.loads(message)
        raise AssertionError("it never held")

    def run(self) -> None:
        """Until the program runs; on a busy machine it may have to be started more than once."""

        def runs(phase: str, _shown: object) -> bool:
            if phase.startswith("stopped"):
                self.say({"command": "start"})
            return phase == "running"

        self.until(runs)


@contextmanager
def watching(address: str):
    place, token = address.split("/#token=")
    with connect(f"{place.replace('http', 'ws')}/api/live", close_timeout=0.2) as socket:
        yield Watcher(socket, token)


@pytest.mark.real_time
def test_served_table_is_run_from_the_page_of_another_program(tmp_path):
    channel = str(tmp_path / "sock")
    with (
        started("serve", "array18", "--name", channel) as served,
        started("run", "array18", "-i", "mdms", "-c", channel) as run,
        watching(run) as host,
        watching(served) as table,
    ):
        host.run()
        # The served table shows what another program does to its cells.
        table.until(lambda phase, shown: (shown["cell_state"] == CellState.RUNNING).all())
        table.until(lambda phase, shown: (abs(shown["wheel_reference"]) > 0.01).any())
        # It starts no program of its own beside that, which goes on.
        assert "another host runs on this bus" in table.ask("start")["text"]
        table.until(lambda phase, shown: phase == "another host drives")
        host.say({"command": "stop_all"})
        host.until(lambda phase, _: phase.startswith("stopped"))
        table.until(lambda phase, shown: not (shown["cell_state"] == CellState.RUNNING).any())
        host.run()
        # A client of the served table may stop it without driving it, too.
        table.say({"command": "stop_all"})
        table.until(lambda phase, shown: not (shown["cell_state"] == CellState.RUNNING).any())
        host.until(lambda phase, _: phase != "running")


@pytest.mark.parametrize(
    "arguments",
    [
        ("run", "array18", "--json"),
        ("run", "array18", "--out", "somewhere"),
        ("replay", "somewhere", "--all"),
        ("replay", "somewhere", "--nodes", "cpython"),
    ],
)
def test_an_option_that_does_not_go_with_a_page_is_refused(arguments, capsys):
    assert main([*arguments, "--page", "0"]) == ExitCode.USAGE
    assert "--page" in capsys.readouterr().err
