"""The process of a line's servers: `python -m mdms_host.line.servers DESCRIPTOR`.

It is apart from the table's process, whose control cycle would wait for it. It ends with it.
"""

import asyncio
import json
import signal
import socket
import sys
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from mdms_host.line.modbus import ModbusServer
from mdms_host.line.order_book import OrderBook, OrderBookError
from mdms_host.line.plant import Plant
from mdms_host.line.registers import PlantRegisters

BOOK = "orders.sqlite"
#: The longest message between the two processes [bytes].
_LONGEST = 1 << 20
#: Connections are closed within this [s].
_CLOSES_S = 1.0


async def serve(descriptor: int) -> None:
    """Open the servers that the first message names, and serve until the table is gone."""
    pair = socket.socket(fileno=descriptor)
    reader, writer = await asyncio.open_connection(sock=pair, limit=_LONGEST)
    settings = json.loads(await reader.readline())
    try:
        book = OrderBook(Path(settings["folder"]) / BOOK)
    except (OrderBookError, OSError) as error:
        return await _fail(writer, str(error))
    with book:
        names = {each: settings[each] for each in ("exits", "recipes", "kinds")}
        plant = Plant(book, reader, writer, **names)
        plant.begin()
        tasks = [asyncio.create_task(plant.listen())]
        shown = asyncio.create_task(plant.until_shown())
        await asyncio.wait((shown, *tasks), return_when=asyncio.FIRST_COMPLETED)
        modbus = ModbusServer(PlantRegisters(plant))
        try:
            addresses = await _open(plant, settings, modbus, tasks)
        except (OSError, ValueError) as error:
            return await _fail(writer, f"a server of the line cannot be opened: {error}")
        tasks.append(asyncio.create_task(plant.look_for_pauses()))
        plant.say_open(addresses)
        # If one fails all end, and the table with them: a line must not look alive.
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in tasks:
            task.cancel()
        # No client is served from a book that is closed.
        with suppress(TimeoutError):
            await asyncio.wait_for(modbus.close(), _CLOSES_S)
        for task in done:
            task.result()
    return None


async def _fail(writer: asyncio.StreamWriter, text: str) -> None:
    writer.write(json.dumps({"failed": text}).encode() + b"\n")
    await writer.drain()


async def _open(
    plant: Plant,
    settings: dict[str, Any],
    modbus: ModbusServer,
    tasks: "list[asyncio.Task[None]]",
) -> list[str]:
    """Open the servers; returns their addresses, and adds the tasks that run beside them."""
    addresses, host = [], settings["host"]
    if settings["modbus"] is not None:
        await modbus.open(host, settings["modbus"])
        addresses.append(modbus.address)
    if settings["opcua"] is not None:
        # OPC UA is an extra.
        from mdms_host.line.opcua import OpcUaServer, checked_nodeset  # noqa: PLC0415

        checked_nodeset()
        opcua = OpcUaServer(plant, settings["title"])
        await opcua.open(host, settings["opcua"] or _free_port(host), settings)
        addresses.append(opcua.address)
        tasks.append(asyncio.create_task(_show(plant, opcua.show)))
    return addresses


async def _show(plant: Plant, show: Callable[[], Awaitable[None]]) -> None:
    """Have a server show every snapshot that it is in time for."""
    fresh = asyncio.Event()
    plant.on_snapshot.append(fresh.set)
    while True:
        await fresh.wait()
        fresh.clear()
        await show()


def _free_port(host: str) -> int:
    with socket.create_server((host, 0)) as free:
        return int(free.getsockname()[1])


def main() -> None:
    """Begin; Ctrl-C is for the table."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    asyncio.run(serve(int(sys.argv[1])))


if __name__ == "__main__":
    main()
