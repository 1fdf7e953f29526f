"""The content of all protocols: the machine's last snapshot, the orders, and requests to the
machine.

It runs in the process of the servers. An order is on the disk before it is acknowledged.
"""

import asyncio
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from math import inf
from time import monotonic
from typing import Any

from mdms_host.line.order_book import OrderBook, OrderBookError
from mdms_host.line.packml import STANDS, Command, Mode, State
from mdms_host.programs.table_orders import LineOrder, OrderState

#: The table carries out a request within this, or refuses it [s].
_ANSWER_S = 5.0
#: Without an answer for so much longer, the table is taken for hung [s].
_DELIVERY_S = 1.0
#: Figures are kept on the disk this often [s].
_KEEP_S = 1.0
#: The servers look so often whether they have stood still, for the limit of a heartbeat [s].
_LOOK_S = 0.1
_STILL_S = 1.0
#: Messages that have waited meanwhile are read in so many rounds of the loop.
_ROUNDS = 20
#: Longest key or name of a parcel, an exit or a kind.
LONGEST = 64

#: The snapshot before the table has sent any.
NOTHING: dict[str, Any] = {
    "state": int(State.STOPPED),
    "mode": int(Mode.PRODUCTION),
    "reason": "",
    "recipe": "",
    "since_s": 0.0,
    "changes": 0,
    "spent_s": {},
    "alive": False,
    "figures": {"parcels_in": 0, "parcels_lost": 0, "parcels_rejected": 0, "out": {}},
    "parcels_per_hour": 0.0,
    "availability": 0.0,
    "performance": 0.0,
    "quality": 0.0,
    "exits_full": [],
    "orders_open": 0,
    "blocked": False,
    "starved": False,
    "alarm": None,
    "parcels": [],
    "cells": [],
}


class RequestRefusedError(Exception):
    """A request that the table or the order book refuses: one line for a person."""


class Plant:
    """The table as the servers see it.

    It has exits, recipes that are allowed, and kinds of parcels that come, all by name. Without any
    `kinds` a program alone knows what comes.
    """

    def __init__(
        self,
        book: OrderBook,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        *,
        exits: Sequence[str],
        recipes: Sequence[str],
        kinds: Sequence[str],
    ) -> None:
        self.book = book
        self.exits = exits
        self.recipes = recipes
        self.kinds = kinds
        self.snapshot = NOTHING
        #: How many snapshots have come, for clients that watch whether the table lives.
        self.beats = 0
        self.on_snapshot: list[Callable[[], object]] = []
        self.on_report: list[Callable[[dict[str, Any]], object]] = []
        self._reader = reader
        self._writer = writer
        self._waiting: dict[int, asyncio.Future[str | None]] = {}
        #: When the servers ran last, with nothing left that had waited [s].
        self._ran_s = inf
        self._number = 0
        self._kept_s = 0.0
        self._keeps = True
        self._choosing = asyncio.Lock()
        #: What clients have set, by name, which a restart must not forget.
        self._settings: dict[str, Any] = {}

    @property
    def out_by_exit(self) -> list[int]:
        """How many parcels have left by each exit."""
        out = self.snapshot["figures"]["out"]
        return [out.get(exit, 0) for exit in self.exits]

    @property
    def state_times_s(self) -> list[float]:
        """The time in each state, by its number from 1 [s]."""
        spent_s = {int(state): float(each) for state, each in self.snapshot["spent_s"].items()}
        return [spent_s.get(int(state), 0.0) for state in State]

    # Requests of clients -------------------------------------------------------------------------

    async def command(self, command: Command, by: str) -> None:
        """Give the machine a command. Raises `RequestRefusedError`.

        One by which parcels stand is carried out however late the table takes it.
        """
        await self._ask("command", late=command in STANDS, command=int(command), by=by)

    async def change_mode(self, mode: int) -> None:
        """Change the machine's mode. Raises `RequestRefusedError`."""
        if mode not in tuple(Mode):
            modes = ", ".join(f"{int(each)} {each.name.capitalize()}" for each in Mode)
            raise RequestRefusedError(f"mode {mode} is none; there are: {modes}")
        await self._ask("mode", mode=mode)
        self._keep_settings(mode=mode)

    def beat(self, by: str) -> None:
        """A client lives, or did so when the servers stood still."""
        self._tell("beat", by=by, at_s=self._came_s())

    def order(self, order: LineOrder) -> tuple[str, bool]:
        """Accept an order once; returns its state, and whether it is new.

        Raises `RequestRefusedError`.
        """
        _check_texts(order.key, order.parcel, order.exit or "")
        if order.exit is not None and order.exit not in self.exits:
            raise RequestRefusedError(self._no_exit(order.exit))
        try:
            state, is_new = self.book.accept(order)
        except OrderBookError as error:
            raise RequestRefusedError(str(error)) from None
        if is_new:
            self._tell("order", order=asdict(order))
        return state, is_new

    async def cancel(self, key: str) -> None:
        """Cancel an order that has not begun, waits before a full exit, or is in doubt.

        Raises `RequestRefusedError`.
        """
        state = self.book.state(key)
        if state in (OrderState.ACCEPTED, OrderState.UNDER_WAY, OrderState.IN_DOUBT):
            try:
                await self._ask("cancel", key=key)
            except RequestRefusedError:
                # Another client may have cancelled it meanwhile.
                if self.book.state(key) != OrderState.CANCELLED:
                    raise
        elif state != OrderState.CANCELLED:
            raise RequestRefusedError(
                f"order {key} is {state}, and over" if state else f"there is no order {key}"
            )
        self.book.change(key, OrderState.CANCELLED)
        if self.book.trouble is not None:
            raise RequestRefusedError(
                f"order {key} is cancelled, but that cannot be kept: {self.book.trouble}"
            )

    async def coming(self, parcel: str, kind: str) -> None:
        """A scanner has seen a parcel that comes next. Raises `RequestRefusedError`."""
        _check_texts(parcel, kind)
        if not parcel:
            raise RequestRefusedError("a parcel that comes needs an identity")
        if kind and self.kinds and kind not in self.kinds:
            raise RequestRefusedError(f"no kind {kind!r:.40}; there are: {', '.join(self.kinds)}")
        await self._ask("coming", parcel=parcel, kind=kind)

    async def not_coming(self, parcel: str) -> None:
        """A parcel that was announced does not come after all. Raises `RequestRefusedError`."""
        await self._ask("not_coming", parcel=parcel)

    async def set_exit(self, exit: str, full: bool) -> None:
        """An exit is full, or free again. Raises `RequestRefusedError`."""
        if exit not in self.exits:
            raise RequestRefusedError(self._no_exit(exit))
        await self._ask("exit", exit=exit, full=full)
        others = [each for each in self._settings.get("exits_full", []) if each != exit]
        self._keep_settings(exits_full=sorted([*others, exit] if full else others))

    async def choose(self, recipe: str) -> None:
        """Have the next run follow a recipe, also after the host was killed.

        Raises `RequestRefusedError`.
        """
        # The book must be right whatever comes of two choices at once.
        async with self._choosing:
            before = self.book.kept("recipe")
            try:
                self.book.keep("recipe", recipe)
                if self.book.trouble is not None:
                    raise RequestRefusedError(
                        f"the recipe {recipe!r:.40} cannot be kept: {self.book.trouble}"
                    )
                await self._ask("recipe", recipe=recipe)
            except RequestRefusedError:
                self.book.keep("recipe", before)
                raise

    async def set_ideal(self, per_hour: float) -> None:
        """The rate that counts as performance 1. Raises `RequestRefusedError`."""
        if not 0.0 <= per_hour <= 1e6:
            raise RequestRefusedError(f"{per_hour:g} parcels an hour is not 0 to 1000000")
        await self._ask("ideal", per_hour=per_hour)
        self._keep_settings(ideal_per_hour=per_hour)

    def _keep_settings(self, **changes: Any) -> None:
        # Clients repeat settings, and each write takes the disk a while.
        if self._settings != (settings := self._settings | changes):
            self._settings = settings
            self.book.keep("settings", settings)

    def _no_exit(self, exit: str) -> str:
        return f"no exit {exit!r:.40}; there are: {', '.join(self.exits) or 'none'}"

    async def look_for_pauses(self) -> None:
        """Note when the servers stand still, as on a slow disk; for ever, once they are open."""
        while True:
            self._ran_s = monotonic()
            await asyncio.sleep(_LOOK_S)
            if self._came_s() == self._ran_s:
                for _ in range(_ROUNDS):
                    await asyncio.sleep(0)

    def _came_s(self) -> float:
        """The time by which a message that is read now counts, by `monotonic` [s].

        It has waited if the servers stood still, and its client may be gone since.
        """
        now_s = monotonic()
        return self._ran_s if now_s - self._ran_s > _STILL_S else now_s

    # The table -----------------------------------------------------------------------------------

    def begin(self) -> None:
        """Give the table the orders, figures, recipe and settings of before."""
        kept = self.book.kept("machine")
        if kept is not None:
            self._tell("restore", **kept)
        self._settings = self.book.kept("settings") or {}
        for exit in self._settings.get("exits_full", []):
            self._tell("exit", exit=exit, full=True)
        if "mode" in self._settings:
            self._tell("mode", mode=self._settings["mode"])
        if "ideal_per_hour" in self._settings:
            self._tell("ideal", per_hour=self._settings["ideal_per_hour"])
        recipe = self.book.kept("recipe")
        if recipe is not None:
            self._tell("chosen", recipe=recipe)
        for order in self.book.in_state(OrderState.ACCEPTED):
            self._tell("order", order=asdict(order))
        for order in self.book.in_state(OrderState.IN_DOUBT):
            self._tell("in_doubt", order=asdict(order))

    async def until_shown(self) -> None:
        """Wait until the table has taken that, and shows it: a client that is early sees it too."""
        shown = asyncio.Event()
        self.on_snapshot.append(shown.set)
        self._write({"show": True})
        await shown.wait()
        self.on_snapshot.remove(shown.set)

    def say_open(self, addresses: list[str]) -> None:
        """The servers are open."""
        self._write({"open": addresses})

    async def listen(self) -> None:
        """Take in the messages of the table until it is gone, and keep its last figures."""
        while line := await self._line():
            message = json.loads(line)
            if "snapshot" in message:
                self._see(message["snapshot"])
            elif "report" in message:
                report = message["report"]
                self.book.on_event(report["key"], report["event"], report["text"])
                for tell in self.on_report:
                    tell(report)
            elif (answer := self._waiting.pop(message["id"], None)) and not answer.done():
                answer.set_result(message["error"])
        if self.beats:
            self._keep()

    async def _line(self) -> bytes:
        """The next message; empty when the table is gone, also when it was killed."""
        try:
            return await self._reader.readline()
        except ConnectionError:
            return b""

    def _see(self, snapshot: dict[str, Any]) -> None:
        self.snapshot = snapshot
        self.beats += 1
        now_s = asyncio.get_running_loop().time()
        if now_s >= self._kept_s + _KEEP_S:
            self._kept_s = now_s
            self._keep()
        for tell in self.on_snapshot:
            tell()

    def _keep(self) -> None:
        state = State(self.snapshot["state"])
        over = state in (State.STOPPED, State.ABORTED)
        name = state.name.capitalize()
        reason = self.snapshot["reason"] if over else f"the host has ended in {name}"
        kept = {"figures": self.snapshot["figures"], "spent_s": self.snapshot["spent_s"]}
        self.book.keep("machine", {**kept, "reason": reason})
        trouble, kept_before = self.book.trouble, self._keeps
        self._keeps = trouble is None
        if kept_before and not self._keeps:
            self._write({"note": f"the order book cannot be kept, and is tried again: {trouble}"})
        elif self._keeps and not kept_before:
            self._write({"note": "the order book is kept again"})

    async def _ask(self, name: str, *, late: bool = False, **values: Any) -> None:
        self._number += 1
        number, loop = self._number, asyncio.get_running_loop()
        answer = self._waiting[number] = loop.create_future()
        # A request that is refused as late is not done later, unless that is asked for.
        until = {} if late else {"until_s": monotonic() + _ANSWER_S}
        self._tell(name, id=number, **until, **values)
        try:
            error = await asyncio.wait_for(answer, _ANSWER_S + _DELIVERY_S)
        except TimeoutError:
            self._waiting.pop(number, None)
            raise RequestRefusedError("the table does not answer: it is busy") from None
        if error is not None:
            raise RequestRefusedError(error)

    def _tell(self, name: str, **values: Any) -> None:
        self._write({"do": name, **values})

    def _write(self, message: dict[str, Any]) -> None:
        self._writer.write(json.dumps(message).encode() + b"\n")


def _check_texts(*texts: str) -> None:
    for text in texts:
        if len(text) > LONGEST or not text.isprintable():
            raise RequestRefusedError(f"{text!r:.70} is not {LONGEST} printable characters at most")
