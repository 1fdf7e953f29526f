"""What a client of Modbus reads and causes, also one that goes on over a restart of the host."""

import asyncio
from pathlib import Path

from tests.host.line.played_table import full_disk, plant_in

from mdms_host.line.packml import Command
from mdms_host.line.registers import COMING, PlantRegisters

COMMAND, REQUEST = 101, 200
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
