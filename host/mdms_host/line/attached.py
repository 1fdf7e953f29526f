"""A line that is attached to a table: its machine here, its servers in a process of their own.

The two processes send each other messages, each a line of JSON on a socket pair. The table's side
never waits.
"""

import json
import socket
import subprocess
import sys
from contextlib import suppress
from dataclasses import asdict
from math import inf
from time import monotonic
from typing import Any, Self

from mdms_host.clock import MonotonicClock
from mdms_host.line.machine import Machine, Recipes
from mdms_host.line.packml import CommandRefusedError
from mdms_host.page.live import LiveTable
from mdms_host.page.run_slot import RunSlot
from mdms_host.programs.table_orders import Report
from mdms_host.programs.table_parcel import ProgramError
from mdms_model.errors import Error

#: How often the servers are told how everything is [s].
_SNAPSHOT_S = 0.1
#: How often a page is shown the line [s].
_SHOW_S = 0.5
#: The servers say that they are open within this [s].
_OPENS_S = 30.0
#: Bytes that wait for a server that does not read; beyond them it has failed.
_MOST_WAITING = 4_000_000
_READ_BYTES = 65536


class LineError(Error):
    """The line cannot be opened, or its servers have ended."""


class ServersProcess:
    """The process of the servers, from the table's side; close it when done."""

    def __init__(self, settings: dict[str, Any]) -> None:
        self._socket, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "mdms_host.line.servers", str(theirs.fileno())],
                pass_fds=(theirs.fileno(),),
                stdin=subprocess.DEVNULL,
                # Ctrl-C is for the table, which ends the servers in order.
                start_new_session=True,
            )
        self._socket.setblocking(False)
        self._in = b""
        self._out = b""
        self.send(settings)

    def close(self) -> None:
        """End the servers: they see that the table is gone."""
        self._socket.close()
        self._ended()

    def send(self, message: dict[str, Any]) -> None:
        """Send a message, now or with the next one. Raises `LineError`."""
        self._out += json.dumps(message).encode() + b"\n"
        self.flushed()

    def flushed(self) -> bool:
        """Send as much as the servers take now, and return whether that was all.

        Raises `LineError`.
        """
        try:
            while self._out:
                self._out = self._out[self._socket.send(self._out) :]
        except BlockingIOError:
            if len(self._out) > _MOST_WAITING:
                raise LineError("the servers of the line do not read") from None
        except OSError as error:
            raise LineError(f"the servers of the line are gone: {error}") from None
        return not self._out

    def receive(self) -> list[dict[str, Any]]:
        """Messages that have come, the last ones of a process that has ended too.

        Raises `LineError` when it has ended, and nothing of it is left.
        """
        gone = False
        try:
            while data := self._socket.recv(_READ_BYTES):
                self._in += data
            gone = True
        except BlockingIOError:
            pass
        except OSError:
            gone = True
        *lines, self._in = self._in.split(b"\n")
        if gone and not lines:
            raise LineError(f"the servers of the line have ended, with {self._ended()}")
        return [json.loads(line) for line in lines]

    def _ended(self) -> int:
        """The exit code of the process, which is killed if it does not end."""
        try:
            return self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()


class Line:
    """A table's place in a line; close it when done.

    The driver of the table calls `attend` as often as it can. Nothing of it waits. `settings` are
    those of the servers. The slot makes its runs by the chosen one of `recipes`. The page of the
    `table` shows the line, and what happens. Raises `LineError`.
    """

    def __init__(
        self,
        slot: RunSlot,
        exits: tuple[str, ...],
        settings: dict[str, Any],
        recipes: Recipes[Any],
        table: LiveTable,
    ) -> None:
        self._clock = clock = MonotonicClock()
        self._table = table
        self._show_due_s = 0.0
        self._due_s = 0.0
        self._changes = -1
        self._recipe = recipes.chosen
        self.machine = Machine(slot, exits, clock.now_s, self._report, recipes)
        self._servers = ServersProcess({**settings, "exits": exits, "recipes": recipes.names})
        try:
            self.addresses: list[str] = self._await_open()
        except BaseException:
            self._servers.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        # A run that has just ended in order is to be seen so: it stops, and has stopped.
        try:
            with suppress(LineError):
                for _ in range(2):
                    self.machine.step()
                self._servers.send({"snapshot": self.machine.snapshot()})
        finally:
            self._servers.close()

    def _await_open(self) -> list[str]:
        """Addresses of the servers, once they are open; orders of before have come by then."""
        until_s = self._clock.now_s() + _OPENS_S
        while self._clock.now_s() < until_s:
            for message in self._servers.receive():
                if "failed" in message:
                    raise LineError(message["failed"])
                if "open" in message:
                    return list(message["open"])
                self._answer(message)
            self._clock.sleep(0.01)
        raise LineError(f"the servers of the line are not open after {_OPENS_S:g} s")

    def attend(self) -> bool:
        """Carry out requests, go on, and tell the servers; returns whether a snapshot went out.

        Raises `LineError`.
        """
        for message in self._servers.receive():
            self._answer(message)
        self.machine.step()
        states, now_s = self.machine.states, self._clock.now_s()
        if self._recipe != self.machine.recipes.chosen:
            self._recipe = self.machine.recipes.chosen
            self._note(f"line: recipe {self._recipe}")
        if states.changes != self._changes:
            self._changes = states.changes
            self._note(f"line: {states.state.name.capitalize()} {states.reason}".rstrip())
            self._due_s = self._show_due_s = now_s
        # A snapshot waits for servers that are behind; reports and answers do not.
        if now_s < self._due_s or not self._servers.flushed():
            return False
        self._due_s = now_s + _SNAPSHOT_S
        self._servers.send({"snapshot": self.machine.snapshot()})
        if now_s >= self._show_due_s:
            self._show_due_s = now_s + _SHOW_S
            self._table.show_line(self.machine.shown())
        return True

    def _answer(self, message: dict[str, Any]) -> None:
        if "note" in message:
            self._note(f"line: {message['note']}")
            return
        if "show" in message:
            self._servers.send({"snapshot": self.machine.snapshot()})
            return
        error = None
        try:
            # The servers have the same clock. Their client has been told of a refusal by now.
            if monotonic() > message.get("until_s", inf):
                raise CommandRefusedError("the request came too late")
            if "at_s" in message:
                message["age_s"] = monotonic() - message["at_s"]
            self.machine.do(message["do"], message)
        except (CommandRefusedError, ProgramError) as refused:
            error = str(refused)
            if message["do"] == "order":
                # The client has been told that it is accepted, so its state says otherwise.
                given = message["order"]
                self._report(Report("refused", given["parcel"], given["key"], text=error))
        if "id" in message:
            self._servers.send({"id": message["id"], "error": error})

    def _report(self, report: Report) -> None:
        if report.key:
            where = f" by {report.exit}" if report.event == "left" else ""
            why = f": {report.text}" if report.text else ""
            self._note(f"order {report.key}: {report.parcel} {report.event}{where}{why}")
        self._servers.send({"report": asdict(report)})

    def _note(self, text: str) -> None:
        self._table.note("line", text)
