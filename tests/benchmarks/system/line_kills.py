"""Orders survive: the process of the order book is killed 1,000 times, `mdms run` twice 20 times.

`python -m tests.benchmarks line_kills`; MDMS_KILLS and MDMS_HOST_KILLS set other numbers. Clients
give orders when the process is killed, and give the last one again: by Modbus, and by node-opcua.
No order that was acknowledged may be lost, none may be accepted twice, and none may be repeated by
itself.
"""

import os
import socket
import struct
import time
from multiprocessing import get_context
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from threading import Timer
from time import perf_counter
from typing import Any, Self

from tests.host.line.virtual_line import take_parcels_off
from tests.system.line.controller import PATIENCE_S, STOPPED, admit_user
from tests.system.line.node_client import ClientError, NodeClient, check_is_there
from tests.system.links.going_away import Plant

from mdms_host.line.order_book import OrderBook
from mdms_host.line.registers import ASK, COMING, ORDER_STATES
from mdms_host.line.servers import BOOK
from mdms_host.programs.table_orders import LineOrder, OrderState

KILLS = int(os.environ.get("MDMS_KILLS", "1000"))
HOST_KILLS = int(os.environ.get("MDMS_HOST_KILLS", "20"))
#: Orders between two kills, at most.
ORDERS = 20
_WAY_BACK = {
    "Aborted": "Clear",
    "Stopped": "Reset",
    "Idle": "Start",
    "Held": "Unhold",
    "Suspended": "Unsuspend",
}
_DOUBTFUL = (OrderState.IN_DOUBT, OrderState.CANCELLED)


def run() -> list[dict[str, Any]]:
    """The order book, and hosts with each protocol."""
    check_is_there()
    return [_book(), _hosts(_ByModbus), _hosts(_ByOpcua)]


# The process of the order book -------------------------------------------------------------------


def _keep_book(path: Path, theirs: socket.socket) -> None:
    """Accept orders by number, and answer each when it is on the disk: 2, or 1 for a known one."""
    with OrderBook(path) as book:
        theirs.sendall(b"\0")
        while asked := theirs.recv(4, socket.MSG_WAITALL):
            (number,) = struct.unpack("<I", asked)
            _, is_new = book.accept(LineOrder(f"k{number}", f"P-{number}", "east"))
            theirs.sendall(bytes((1 + is_new,)))


def _book() -> dict[str, Any]:
    random, context = Random(3), get_context("fork")
    acknowledged: set[int] = set()
    number = again = lost = 0
    with TemporaryDirectory() as folder:
        path = Path(folder) / "orders.sqlite"
        for _ in range(KILLS):
            ours, theirs = socket.socketpair()
            keeper = context.Process(target=_keep_book, args=(path, theirs), daemon=True)
            keeper.start()
            theirs.close()
            with ours:
                assert ours.recv(1) == b"\0"
                until_s = perf_counter() + random.uniform(0.0, 0.05)
                while perf_counter() < until_s:
                    ours.sendall(struct.pack("<I", number))
                    answer = ours.recv(1)
                    again += answer == b"\1"
                    acknowledged.add(number)
                    number += 1
                # One more is on its way when the process is killed; it is given again next.
                ours.sendall(struct.pack("<I", number))
                time.sleep(random.uniform(0.0, 0.003))
                keeper.kill()
                keeper.join()
        with OrderBook(path) as book:
            states = book.counts()
            lost = sum(book.state(f"k{each}") is None for each in acknowledged)
            twice = sum(states.values()) - len({*acknowledged, number}) > 0
    return {
        "name": f"the order book's process killed {KILLS} times: lost",
        "ours": lost,
        "unit": "orders",
        "failed": bool(lost or twice) or set(states) != {OrderState.ACCEPTED},
        "orders": len(acknowledged),
        "known_when_given_again": again,
    }


# Whole hosts -------------------------------------------------------------------------------------


class _ByModbus:
    """The plant's controller, which speaks Modbus byte by byte."""

    name, options = "Modbus", ()

    def __init__(self, plant: Plant, _folder: Path) -> None:
        self._plant = plant

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        pass

    def connect(self) -> None:
        """The plant has connected it."""

    def to_execute(self) -> None:
        self._plant.bring_to_execute()

    def beat(self) -> None:
        self._plant.controller.beat()

    def announce(self, parcel: str) -> None:
        self._plant.controller.order(COMING, "", parcel)

    def give(self, key: str) -> bool:
        """Whether an order was new."""
        result = self._plant.give(key)
        assert result in (0, 1)
        return result == 0

    def state(self, key: str) -> str | None:
        result, state = self._plant.controller.order(ASK, key)
        return ORDER_STATES[state - 1] if result == 0 else None


class _ByOpcua:
    """node-opcua in a process of its own; it gives the heartbeat by itself."""

    name, options = "OPC UA", ("--opcua", "0")

    def __init__(self, plant: Plant, folder: Path) -> None:
        self._plant = plant
        self._folder = folder
        self._client = NodeClient("opcua")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._client.__exit__()

    def connect(self) -> None:
        """Connect to the host that has begun."""
        self._client.connect(self._plant.opcua, str(self._folder / "pki"))

    def to_execute(self) -> None:
        # A busy machine may hold or abort a run.
        end_s = time.monotonic() + PATIENCE_S
        while (state := self._client.ask("state")) != "Execute":
            assert time.monotonic() < end_s, (state, self._plant.said[-20:])
            if state in _WAY_BACK:
                try:
                    self._client.ask("command", _WAY_BACK[state])
                except ClientError as error:
                    # The heartbeat is taken in with the next snapshot.
                    if not error.refused:
                        raise
            time.sleep(0.2)

    def beat(self) -> None:
        """It beats by itself; this shows whether the host is there."""
        self._client.ask("state")

    def announce(self, parcel: str) -> None:
        self._client.ask("coming", parcel)

    def give(self, key: str) -> bool:
        """Whether an order was new."""
        return bool(self._client.ask("order", key, f"P{key}", "east"))

    def state(self, key: str) -> str | None:
        state = self._client.ask("ask", key)
        return None if state == "unknown" else str(state)


def _hosts(client_of: type[_ByModbus] | type[_ByOpcua]) -> dict[str, Any]:
    random = Random(4)
    given: set[str] = set()
    doubtful: set[str] = set()
    lost = twice = repeated = 0
    with TemporaryDirectory() as text:
        folder = Path(text)
        admit_user(folder)
        with (
            Plant(folder, "mdms", *client_of.options) as plant,
            client_of(plant, folder) as client,
        ):
            client.connect()
            for kill in range(HOST_KILLS):
                client.to_execute()
                Timer(random.uniform(0.1, 6.0), plant.host.kill).start()
                new, cut = _give_until_killed(client, kill, random)
                given |= new
                plant.host.wait()
                # Parcels on the way would be in the way of all that come.
                plant.at_table(lambda: take_parcels_off(plant.simulation))
                plant.begin_host_again()
                client.connect()
                assert plant.state() == STOPPED
                states = {key: client.state(key) for key in sorted(given)}
                lost += sum(state is None for state in states.values())
                repeated += sum(states[key] not in _DOUBTFUL for key in doubtful)
                doubtful = {key for key, state in states.items() if state == OrderState.IN_DOUBT}
                # Nobody knows whether the last one was accepted: its client gives it again.
                twice += sum(client.give(key) for key in new)
                client.give(cut)
                given.add(cut)
            states = {key: client.state(key) for key in sorted(given)}
            left = sum(state == OrderState.LEFT for state in states.values())
            exits = sum(event.kind == "exit" for event in plant.simulation.world.events)
        with OrderBook(folder / BOOK) as book:
            twice += sum(book.counts().values()) - len(given)
    return {
        "name": f"hosts with {client_of.name} killed {HOST_KILLS} times: lost, twice or repeated",
        "ours": lost + twice + repeated,
        "unit": "orders",
        "failed": bool(lost or twice or repeated) or left > exits,
        "orders": len(given),
        "left": left,
        "parcels_that_left": exits,
        "in_doubt": len(doubtful),
    }


def _give_until_killed(
    client: _ByModbus | _ByOpcua, kill: int, random: Random
) -> tuple[set[str], str]:
    """Give orders until the host is gone: those that it acknowledged, and the last one."""
    given: set[str] = set()
    number = 0
    while True:
        key = f"{kill}-{number}"
        try:
            client.beat()
            if number < ORDERS:
                client.announce(f"P{key}")
                assert client.give(key)
                given.add(key)
                number += 1
            time.sleep(random.uniform(0.0, 0.1))
        except (OSError, struct.error, ClientError):
            return given, key
