"""What a plant answers when its order book cannot be written, and what it tells the table."""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import asdict
from pathlib import Path
from time import monotonic
from types import SimpleNamespace
from typing import Any

import pytest
from tests.host.line.played_table import PlayedTable, full_disk, plant_in
from tests.host.line.virtual_line import VirtualLine

from mdms_host.line import attached
from mdms_host.line import plant as plants
from mdms_host.line.order_book import OrderBook
from mdms_host.line.packml import Command, Mode, State
from mdms_host.line.plant import Plant, RequestRefusedError
from mdms_host.programs.table_orders import LineOrder

ORDER = LineOrder("o1", "P-1", "east")


def with_plant(folder: Path, talk: Callable[[Plant, PlayedTable], Awaitable[None]]) -> None:
    async def talk_to_it() -> None:
        async with plant_in(folder) as (plant, table):
            await talk(plant, table)

    asyncio.run(talk_to_it())


def notes(table: PlayedTable) -> list[str]:
    return [message["note"] for message in table.told if "note" in message]


def test_a_full_disk_is_said_once_and_the_plant_goes_on(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(plants, "_KEEP_S", 0.0)

    async def talk(plant: Plant, table: PlayedTable) -> None:
        plant.order(ORDER)
        with full_disk():
            for _ in range(3):
                await table.show(plant)
            table.say({"report": {"key": "o1", "event": "under way", "text": ""}})
            await table.show(plant)
            with pytest.raises(RequestRefusedError, match="o2 cannot be kept"):
                plant.order(LineOrder("o2", "P-2", "east"))
            assert plant.book.state("o1") == "under way"
        assert [order["order"]["key"] for order in table.named("order")] == ["o1"]
        for _ in range(3):
            await table.show(plant)
        assert plant.order(LineOrder("o2", "P-2", "east"))[1]
        first, second = notes(table)
        assert first.startswith("the order book cannot be kept, and is tried again: ")
        assert second == "the order book is kept again"

    with_plant(tmp_path, talk)


@pytest.mark.parametrize("why", ["full disk", "not in Idle"])
def test_a_recipe_that_is_refused_is_not_that_after_a_restart(tmp_path: Path, why: str) -> None:
    async def choose(plant: Plant, table: PlayedTable) -> None:
        await plant.choose("table")
        if why == "full disk":
            with full_disk(), pytest.raises(RequestRefusedError, match="'gentle' cannot be kept"):
                await plant.choose("gentle")
        else:
            table.refuses["recipe"] = why
            with pytest.raises(RequestRefusedError, match=why):
                await plant.choose("gentle")
        assert [message["recipe"] for message in table.named("recipe")][:1] == ["table"]

    async def begin(_plant: Plant, table: PlayedTable) -> None:
        assert [message["recipe"] for message in table.named("chosen")] == ["table"]

    with_plant(tmp_path, choose)
    with_plant(tmp_path, begin)


def test_a_cancellation_that_cannot_be_kept_is_refused_until_it_is(tmp_path: Path) -> None:
    async def talk(plant: Plant, table: PlayedTable) -> None:
        plant.order(ORDER)
        with full_disk():
            for _ in range(2):
                with pytest.raises(RequestRefusedError, match="cancelled, but that cannot be kept"):
                    await plant.cancel("o1")
        await table.show(plant)
        await plant.cancel("o1")
        assert len(table.named("cancel")) == 1
        assert plant.book.state("o1") == "cancelled"

    with_plant(tmp_path, talk)


def test_full_exits_the_mode_and_the_ideal_rate_hold_after_a_restart(tmp_path: Path) -> None:
    async def set_all(plant: Plant, table: PlayedTable) -> None:
        for exit, full in (("north", True), ("east", True), ("east", False)):
            await plant.set_exit(exit, full)
        await plant.change_mode(Mode.MAINTENANCE)
        await plant.set_ideal(900.0)
        table.refuses |= {"mode": "stop first", "exit": "it is busy"}
        for refused in (plant.change_mode(Mode.PRODUCTION), plant.set_exit("north", full=False)):
            with pytest.raises(RequestRefusedError):
                await refused

    async def begin(_plant: Plant, table: PlayedTable) -> None:
        assert [(each["exit"], each["full"]) for each in table.named("exit")] == [("north", True)]
        assert [each["mode"] for each in table.named("mode")] == [Mode.MAINTENANCE]
        assert [each["per_hour"] for each in table.named("ideal")] == [900.0]

    with_plant(tmp_path, set_all)
    for _ in range(2):
        with_plant(tmp_path, begin)


def test_the_last_figures_and_the_last_reason_hold_however_soon_the_table_is_gone(
    tmp_path: Path,
) -> None:
    async def end(plant: Plant, table: PlayedTable) -> None:
        await table.show(plant, state=State.EXECUTE)
        figures = {"parcels_in": 3, "parcels_lost": 0, "parcels_rejected": 0, "out": {"east": 2}}
        await table.show(plant, state=State.STOPPED, reason="Stop by plc", figures=figures)
        table.reader.feed_eof()
        for _ in range(10):
            await asyncio.sleep(0)

    async def begin(_plant: Plant, table: PlayedTable) -> None:
        (restored,) = table.named("restore")
        assert restored["figures"]["out"] == {"east": 2}
        assert restored["reason"] == "Stop by plc"

    with_plant(tmp_path, end)
    with_plant(tmp_path, begin)


def test_a_book_of_before_without_settings_begins_with_none(tmp_path: Path) -> None:
    with OrderBook(tmp_path / "orders.sqlite") as book:
        book.keep("machine", {"figures": {}, "spent_s": {}, "reason": ""})

    async def begin(plant: Plant, table: PlayedTable) -> None:
        assert [each["do"] for each in table.told] == ["restore"]
        await plant.set_exit("north", full=True)

    with_plant(tmp_path, begin)


def test_an_order_under_way_is_cancelled_for_good_if_its_parcel_waits(tmp_path: Path) -> None:
    async def cancel(plant: Plant, table: PlayedTable) -> None:
        plant.order(ORDER)
        table.say({"report": {"key": "o1", "event": "under way", "text": ""}})
        await table.show(plant)
        table.refuses["cancel"] = "o1 is about to leave"
        with pytest.raises(RequestRefusedError, match="about to leave"):
            await plant.cancel("o1")
        assert plant.book.state("o1") == "under way"
        del table.refuses["cancel"]
        await plant.cancel("o1")
        await plant.cancel("o1")
        assert len(table.named("cancel")) == 2
        # The table said so before it was asked.
        table.say({"report": {"key": "o1", "event": "under way", "text": ""}})
        await table.show(plant)
        assert plant.book.state("o1") == "cancelled"

    async def begin(plant: Plant, table: PlayedTable) -> None:
        assert plant.book.state("o1") == "cancelled"
        assert not table.named("order") + table.named("in_doubt")

    with_plant(tmp_path, cancel)
    with_plant(tmp_path, begin)


def test_two_clients_cancel_an_order_at_once(tmp_path: Path) -> None:
    async def talk(plant: Plant, table: PlayedTable) -> None:
        plant.order(ORDER)
        table.answers = False
        both = [asyncio.create_task(plant.cancel("o1")) for _ in range(2)]
        while len(table.named("cancel")) < 2:
            await asyncio.sleep(0)
        first, second = table.named("cancel")
        table.say({"id": first["id"], "error": None})
        table.say({"id": second["id"], "error": "order o1 is over"})
        await asyncio.gather(*both)

    with_plant(tmp_path, talk)


def test_an_order_that_the_table_cancels_at_the_last_moment_is_cancelled(
    tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.setattr(plants, "_ANSWER_S", 0.0)
    monkeypatch.setattr(plants, "_DELIVERY_S", 20.0)

    async def talk(plant: Plant, table: PlayedTable) -> None:
        plant.order(ORDER)
        table.answers = False
        asked = asyncio.create_task(plant.cancel("o1"))
        while not table.named("cancel"):
            await asyncio.sleep(0)
        (told,) = table.named("cancel")
        assert told["until_s"] <= monotonic()
        # It was carried out in time, and the answer took longer.
        await asyncio.sleep(0.01)
        table.say({"id": told["id"], "error": None})
        await asked
        assert plant.book.state("o1") == "cancelled"

    with_plant(tmp_path, talk)


def test_a_kind_that_no_parcel_has_is_refused_and_the_kinds_are_named(tmp_path: Path) -> None:
    async def talk(plant: Plant, table: PlayedTable) -> None:
        with pytest.raises(RequestRefusedError, match=r"^no kind 'Box'; there are: box, disc$"):
            await plant.coming("P-1", "Box")
        await plant.coming("P-1", "box")
        await plant.coming("P-2", "")
        assert [each["kind"] for each in table.named("coming")] == ["box", ""]

    with_plant(tmp_path, talk)


class WaitingServers:
    """Servers whose messages reach the table when a test hands them over."""

    def __init__(self, _settings: dict[str, Any]) -> None:
        self.waiting: list[dict[str, Any]] = [{"open": []}]
        self.answers: list[Any] = []
        self.told: list[dict[str, Any]] = []

    def close(self) -> None:
        pass

    def receive(self) -> list[dict[str, Any]]:
        messages, self.waiting = self.waiting, []
        return messages

    def send(self, message: dict[str, Any]) -> None:
        self.told.append(message)
        if "id" in message:
            self.answers.append(message["error"])

    def flushed(self) -> bool:
        return True


def attached_to(line: VirtualLine, monkeypatch: Any) -> tuple[attached.Line, Any]:
    """The line of a virtual table, with servers whose messages wait."""
    page = SimpleNamespace(note=lambda *_: None, show_line=lambda _: None)
    monkeypatch.setattr(attached, "ServersProcess", WaitingServers)
    monkeypatch.setattr(attached, "MonotonicClock", lambda: SimpleNamespace(now_s=line.now_s))
    for module in (attached, plants):
        monkeypatch.setattr(module, "monotonic", line.now_s)
    whole = attached.Line(line.slot, line.machine.exits, {}, line.recipes, page)
    line.machine = whole.machine
    return whole, whole._servers


@pytest.mark.slow
def test_a_host_that_ends_in_order_tells_of_its_orders_and_that_it_has_stopped(
    monkeypatch: Any,
) -> None:
    with VirtualLine() as line:
        whole, servers = attached_to(line, monkeypatch)
        line.do("order", order=asdict(LineOrder("o1", "box 1", "north")))
        line.bring_to_execute()
        line.until(line.moving, 10.0)
        # Ctrl-C: the run is stopped, and nothing is looked after once it is over.
        line.slot.stop()
        line.simulation.kernel.run_until(line.simulation.kernel.now_ns + 1_000_000_000)
        with whole:
            pass
    *_, in_doubt, last = servers.told
    assert (in_doubt["report"]["key"], in_doubt["report"]["event"]) == ("o1", "in doubt")
    assert (last["snapshot"]["state"], last["snapshot"]["reason"]) == (2, "stopped by hand")


@pytest.mark.slow
def test_wheels_stop_by_a_stop_that_has_waited_and_do_not_start_by_a_start(
    tmp_path: Path, monkeypatch: Any
) -> None:
    def told(command: Command) -> dict[str, Any]:
        """The message by which the servers pass a command on."""
        messages: list[dict[str, Any]] = []

        async def talk(plant: Plant, table: PlayedTable) -> None:
            await plant.command(command, "plc")
            messages.extend(table.named("command"))

        with_plant(tmp_path, talk)
        (message,) = messages
        return message

    with VirtualLine() as line:
        whole, servers = attached_to(line, monkeypatch)

        def late(command: Command) -> None:
            message = told(command)
            line.pass_s(6.0)
            servers.waiting.append(message)
            whole.attend()

        line.command(Command.RESET)
        line.until_state(State.IDLE)
        late(Command.START)
        line.pass_s(1.0)
        assert (line.state, line.moving()) == (State.IDLE, False)
        line.command(Command.START)
        line.until(line.moving, 10.0)
        late(Command.STOP)
        line.until_state(State.STOPPED)
        line.pass_s(2.0)
        assert not line.moving()
        assert servers.answers == ["the request came too late", None]
