"""A line that is attached to a table: its machine here, its servers in a process of their own."""

from dataclasses import asdict
from math import inf
from time import monotonic
from typing import Any, Self

from mdms_host.clock import MonotonicClock
from mdms_host.line.channel import ServersGoneError, ServersProcess
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


class LineError(Error):
    """The line cannot be opened, or its servers have ended."""


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
        self._servers.close()

    def _await_open(self) -> list[str]:
        """Addresses of the servers, once they are open; orders of before have come by then."""
        until_s = self._clock.now_s() + _OPENS_S
        while self._clock.now_s() < until_s:
            for message in self._received():
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
        for message in self._received():
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
        self._send({"snapshot": self.machine.snapshot()})
        if now_s >= self._show_due_s:
            self._show_due_s = now_s + _SHOW_S
            self._table.show_line(self.machine.shown())
        return True

    def _answer(self, message: dict[str, Any]) -> None:
        if "note" in message:
            self._note(f"line: {message['note']}")
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
            self._send({"id": message["id"], "error": error})

    def _report(self, report: Report) -> None:
        if report.key:
            where = f" by {report.exit}" if report.event == "left" else ""
            why = f": {report.text}" if report.text else ""
            self._note(f"order {report.key}: {report.parcel} {report.event}{where}{why}")
        self._send({"report": asdict(report)})

    def _note(self, text: str) -> None:
        self._table.note("line", text)

    def _send(self, message: dict[str, Any]) -> None:
        try:
            self._servers.send(message)
        except ServersGoneError as error:
            raise LineError(str(error)) from None

    def _received(self) -> list[dict[str, Any]]:
        try:
            return self._servers.receive()
        except ServersGoneError as error:
            raise LineError(str(error)) from None
