"""A plant, as protocols serve it, whose table is played: no machine, no process."""

import asyncio
import json
import os
import resource
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from pathlib import Path
from typing import Any

from mdms_host.line.order_book import OrderBook
from mdms_host.line.plant import NOTHING, Plant

_PATIENCE_S = 20.0


class PlayedTable:
    """The table's side: it notes what it is told, and does all requests but those it `refuses`."""

    def __init__(self) -> None:
        self.reader = asyncio.StreamReader()
        self.told: list[dict[str, Any]] = []
        #: Why it refuses requests, by their names.
        self.refuses: dict[str, str] = {}
        #: Whether it answers by itself.
        self.answers = True

    def write(self, data: bytes) -> None:
        message = json.loads(data)
        self.told.append(message)
        if "id" in message and self.answers:
            self.say({"id": message["id"], "error": self.refuses.get(message["do"])})

    def say(self, message: dict[str, Any]) -> None:
        self.reader.feed_data(json.dumps(message).encode() + b"\n")

    def named(self, name: str) -> list[dict[str, Any]]:
        """What it was told to do by this name."""
        return [message for message in self.told if message.get("do") == name]

    async def show(self, plant: Plant, **values: Any) -> None:
        """Send a snapshot, and wait for the plant to see it."""
        beats = plant.beats
        self.say({"snapshot": NOTHING | values})
        async with asyncio.timeout(_PATIENCE_S):
            while plant.beats == beats:
                await asyncio.sleep(0)


@asynccontextmanager
async def plant_in(folder: Path) -> AsyncIterator[tuple[Plant, PlayedTable]]:
    """A plant with exits, recipes and kinds of parcels, whose order book lies in a folder."""
    table = PlayedTable()
    with OrderBook(folder / "orders.sqlite") as book:
        plant = Plant(
            *(book, table.reader, table),  # type: ignore[arg-type]
            exits=("north", "east"),
            recipes=("table", "gentle"),
            kinds=("box", "disc"),
        )
        plant.begin()
        listening = asyncio.create_task(plant.listen())
        try:
            yield plant, table
        finally:
            listening.cancel()
            with suppress(asyncio.CancelledError):
                await listening


@contextmanager
def full_disk(process: int = 0) -> Iterator[None]:
    """Meanwhile a process, else this one, can write into no file, as on a full disk."""
    number = process or os.getpid()
    before = resource.prlimit(number, resource.RLIMIT_FSIZE)
    resource.prlimit(number, resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        yield
    finally:
        resource.prlimit(number, resource.RLIMIT_FSIZE, before)
