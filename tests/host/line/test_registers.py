"""What a client of Modbus reads and causes, also one that goes on over a restart of the host."""

import asyncio
from math import inf
from pathlib import Path

import pytest
from tests.host.line.played_table import full_disk, plant_in

from mdms_host.line.modbus import ModbusError
from mdms_host.line.order_book import OrderBook
from mdms_host.line.packml import Command
from mdms_host.line.registers import (
    ANY_YAW,
    ASK,
    CANCEL,
    COMING,
    NOT_COMING,
    ORDER,
    PlantRegisters,
)

COMMAND, REQUEST = 101, 200
EXITS_SET, RECIPE_SET = 105, 107
COMMAND_ANSWER, REQUEST_ANSWER = (103, 2), (224, 2)


async def write_in_cycles(registers: PlantRegisters, counter: int) -> None:
    """Write what a controller writes in each of its cycles: Reset, and a parcel that comes."""
    for _ in range(3):
        await registers.write(COMMAND, [Command.RESET, counter])
        await registers.write(REQUEST, [counter, COMING])
        await registers.write(215, [int.from_bytes(b"P1", "big")])


def test_a_client_that_writes_in_cycles_causes_nothing_again_by_a_restart(tmp_path: Path) -> None:
    async def talk(counter: int, before: int, given: int) -> None:
        async with plant_in(tmp_path) as (plant, table):
            registers = PlantRegisters(plant)
            for place, count in (COMMAND_ANSWER, REQUEST_ANSWER):
                assert registers.read(place, count)[0] == before
            await registers.write(215, [int.from_bytes(b"P1", "big")])
            await write_in_cycles(registers, counter)
            for place, count in (COMMAND_ANSWER, REQUEST_ANSWER):
                assert registers.read(place, count) == [counter, 0]
            assert len(table.named("command")) == len(table.named("coming")) == given

    for counter, before, given in ((5, 0, 1), (5, 5, 0), (6, 5, 1), (1, 6, 1)):
        asyncio.run(talk(counter, before, given))


def test_a_command_is_given_though_its_answer_cannot_be_kept(tmp_path: Path) -> None:
    async def talk() -> None:
        async with plant_in(tmp_path) as (plant, table):
            registers = PlantRegisters(plant)
            with full_disk():
                await registers.write(COMMAND, [Command.STOP, 1])
            assert registers.read(*COMMAND_ANSWER) == [1, 0]
            assert len(table.named("command")) == 1

    asyncio.run(talk())


def order(counter: int, key: bytes, parcel: bytes, exit: int = 1) -> list[int]:
    """The registers of an order, from `request_counter` on."""
    texts = key.ljust(16, b"\0") + parcel.ljust(16, b"\0")
    words = [int.from_bytes(texts[place : place + 2], "big") for place in range(0, 32, 2)]
    return [counter, ORDER, exit, 0, 0, 0, ANY_YAW, *words]


def test_a_client_that_takes_the_counter_of_another_is_refused(tmp_path: Path) -> None:
    hold, stop = [Command.HOLD, 6], [Command.STOP, 6]
    mine, other = order(6, b"A", b"P-1"), order(6, b"B", b"P-2")

    async def collide() -> None:
        async with plant_in(tmp_path) as (plant, table):
            registers = PlantRegisters(plant)
            for address, given, refused in ((COMMAND, hold, stop), (REQUEST, mine, other)):
                await registers.write(address, given)
                with pytest.raises(ModbusError, match="exception 3"):
                    await registers.write(address, refused)
                assert registers.read(address, len(given)) == given
                await registers.write(address, given)
            # The same by single registers.
            await registers.write(COMMAND, stop[:1])
            with pytest.raises(ModbusError, match="exception 3"):
                await registers.write(COMMAND + 1, stop[1:])
            assert [each["command"] for each in table.named("command")] == [Command.HOLD]
            assert [each["order"]["key"] for each in table.named("order")] == ["A"]
            assert plant.book.state("B") is None

    async def go_on() -> None:
        async with plant_in(tmp_path) as (plant, table):
            registers = PlantRegisters(plant)
            for address, given, refused in ((COMMAND, hold, stop), (REQUEST, mine, other)):
                await registers.write(address, given)
                with pytest.raises(ModbusError, match="exception 3"):
                    await registers.write(address, refused)
            assert not table.named("command")
            await registers.write(COMMAND, [Command.STOP, 7])
            assert registers.read(*COMMAND_ANSWER) == [7, 0]

    asyncio.run(collide())
    asyncio.run(go_on())


def test_a_client_may_clear_what_it_has_given_under_its_counter(tmp_path: Path) -> None:
    async def talk() -> None:
        async with plant_in(tmp_path) as (plant, table):
            registers = PlantRegisters(plant)
            await registers.write(COMMAND, [Command.HOLD, 6])
            await registers.write(REQUEST, order(6, b"A", b"P-1"))
            for beat in (1, 2):
                await registers.write(100, [beat, 0, 6])
                await registers.write(REQUEST, [6, *[0] * 22])
            assert len(table.named("beat")) == 2
            assert len(table.named("command")) == len(table.named("order")) == 1

    asyncio.run(talk())


def test_a_client_that_waits_for_its_answer_gets_no_answer_of_another(tmp_path: Path) -> None:
    async def talk() -> None:
        async with plant_in(tmp_path) as (plant, table):
            registers = PlantRegisters(plant)
            table.refuses["command"] = "not possible in Stopped"
            await registers.write(COMMAND, [Command.STOP, 1])
            assert registers.read(*COMMAND_ANSWER) == [1, 2]
            del table.refuses["command"]
            write = asyncio.gather(
                registers.write(COMMAND, [Command.HOLD, 2]),
                registers.write(COMMAND, [Command.STOP, 2]),
                return_exceptions=True,
            )
            first, second = await write
            assert first is None
            assert isinstance(second, ModbusError)
            assert [each["command"] for each in table.named("command")] == [3, 4]

    asyncio.run(talk())


def test_a_book_of_before_that_has_answers_alone_is_gone_on_with(tmp_path: Path) -> None:
    with OrderBook(tmp_path / "orders.sqlite") as book:
        book.keep("modbus", {"command_answered": 5, "request_answered": 5})

    async def talk() -> None:
        async with plant_in(tmp_path) as (plant, table):
            registers = PlantRegisters(plant)
            await registers.write(COMMAND, [Command.RESET, 5])
            assert not table.named("command")
            await registers.write(COMMAND, [Command.RESET, 6])
            assert len(table.named("command")) == 1

    asyncio.run(talk())


def test_a_rate_that_is_too_large_for_its_register_is_not_a_small_one(tmp_path: Path) -> None:
    """A parcel that leaves 0.05 s after Start makes 72,000 an hour."""

    async def talk() -> None:
        async with plant_in(tmp_path) as (plant, table):
            await table.show(plant, parcels_per_hour=72_000.0, performance=80.0, changes=65_537)
            registers = PlantRegisters(plant)
            assert registers.read(16, 3) == [0xFFFF, 0, 0xFFFF]
            # Counters go on from 0.
            assert registers.read(3, 1) == [1]
            # An ideal rate of 1e-308 parcels an hour is allowed, too.
            await table.show(plant, performance=inf)
            assert registers.read(18, 1) == [0xFFFF]

    asyncio.run(talk())


def test_texts_that_are_not_ascii_are_refused_and_no_two_become_one(tmp_path: Path) -> None:
    async def talk() -> None:
        async with plant_in(tmp_path) as (plant, table):
            registers = PlantRegisters(plant)
            texts = [("Kä", "P-1"), ("Kü", "P-1"), ("K1", "Pä"), ("K2", "Pü")]
            for counter, (key, parcel) in enumerate(texts, 1):
                words = order(counter, key.encode("latin-1"), parcel.encode("latin-1"))
                await registers.write(REQUEST, words)
                assert registers.read(224, 3) == [counter, 2, 0]
            for counter, request in enumerate((CANCEL, COMING, ASK), 5):
                words = order(counter, "Kä".encode("latin-1"), b"P-1")
                await registers.write(REQUEST, [counter, request, *words[2:]])
                assert registers.read(224, 3) == [counter, 2, 0]
            assert not table.named("order") + table.named("coming") + table.named("cancel")
            # A request that has no use for the key does not look at it.
            await registers.write(REQUEST, [8, NOT_COMING])
            assert registers.read(224, 3) == [8, 0, 0]
            assert not plant.book.counts()

    asyncio.run(talk())


@pytest.mark.parametrize(
    ("exits", "mode", "recipe"),
    [(0b01, 7, None), (0b01, 2, None), (0b01, 1, 1), (0b100, 1, None), (None, None, 2)],
)
def test_a_write_that_is_refused_changes_nothing(
    tmp_path: Path, exits: int | None, mode: int | None, recipe: int | None
) -> None:
    first = EXITS_SET if exits is not None else RECIPE_SET
    values = [value for value in (exits, mode, recipe) if value is not None]

    async def talk() -> None:
        async with plant_in(tmp_path) as (plant, table):
            registers = PlantRegisters(plant)
            table.refuses |= {"mode": "stop first", "recipe": "in Idle alone"}
            with pytest.raises(ModbusError, match="exception 3"):
                await registers.write(first, values)
            assert registers.read(first, len(values)) == [0] * len(values)
            assert not table.named("exit")

    asyncio.run(talk())
