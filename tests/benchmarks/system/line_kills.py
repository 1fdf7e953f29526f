"""Orders survive: the process of the order book is killed 1,000 times, `mdms run` 20 times.

`python -m tests.benchmarks line_kills`; MDMS_KILLS and MDMS_HOST_KILLS set other numbers. Clients
give orders when the process is killed, and give the last one again. No order that was acknowledged
may be lost, none may be accepted twice, and none may be repeated by itself.
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
from typing import Any

from tests.system.line.controller import STOPPED
from tests.system.links.going_away import Plant

from mdms_host.line.order_book import OrderBook
from mdms_host.line.servers import BOOK
from mdms_host.programs.table_orders import LineOrder, OrderState

KILLS = int(os.environ.get("MDMS_KILLS", "1000"))
HOST_KILLS = int(os.environ.get("MDMS_HOST_KILLS", "20"))
#: Orders between two kills, at most.
ORDERS = 20
_LEFT, _CANCELLED, _IN_DOUBT = 4, 6, 7
_COMING, _ASK = 2, 3


def run() -> list[dict[str, Any]]:
    """Both."""
    return [_book(), _hosts()]


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


def _hosts() -> dict[str, Any]:
    random = Random(4)
    given: set[str] = set()
    doubtful: set[str] = set()
    lost = twice = repeated = 0
    with TemporaryDirectory() as folder:
        with Plant(Path(folder), "mdms") as plant:
            for kill in range(HOST_KILLS):
                plant.controller.order(_COMING, "", f"P{kill}-0")
                plant.bring_to_execute()
                Timer(random.uniform(0.1, 3.0), plant.host.kill).start()
                new, cut = _give_until_killed(plant, kill, random)
                given |= new
                plant.begin_host_again()
                assert plant.state() == STOPPED
                states = {key: plant.controller.order(_ASK, key) for key in sorted(given)}
                lost += sum(result != 0 for result, _ in states.values())
                repeated += sum(states[key][1] not in (_IN_DOUBT, _CANCELLED) for key in doubtful)
                doubtful = {key for key, (_, state) in states.items() if state == _IN_DOUBT}
                # Nobody knows whether the last one was accepted: its client gives it again.
                twice += sum(plant.give(key) != 1 for key in new)
                plant.give(cut)
                given.add(cut)
            states = {key: plant.controller.order(_ASK, key) for key in sorted(given)}
            left = sum(state == _LEFT for _, state in states.values())
            exits = sum(event.kind == "exit" for event in plant.simulation.world.events)
        with OrderBook(Path(folder) / BOOK) as book:
            twice += sum(book.counts().values()) - len(given)
    return {
        "name": f"whole hosts killed {HOST_KILLS} times: lost, twice or repeated",
        "ours": lost + twice + repeated,
        "unit": "orders",
        "failed": bool(lost or twice or repeated) or left > exits,
        "orders": len(given),
        "left": left,
        "parcels_that_left": exits,
        "in_doubt": len(doubtful),
    }


def _give_until_killed(plant: Plant, kill: int, random: Random) -> tuple[set[str], str]:
    """Give orders until the host is gone: those that it acknowledged, and the last one."""
    given: set[str] = set()
    number = 0
    while True:
        key = f"{kill}-{number}"
        try:
            plant.controller.beat()
            if number < ORDERS:
                if number:
                    plant.controller.order(_COMING, "", f"P{key}")
                assert plant.give(key) == 0
                given.add(key)
                number += 1
            time.sleep(random.uniform(0.0, 0.1))
        except (OSError, struct.error):
            return given, key
