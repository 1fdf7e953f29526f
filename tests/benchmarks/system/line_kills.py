"""Orders survive: the process of the order book is killed 1,000 times, the whole host 20 times.

`python -m tests.benchmarks line_kills`; MDMS_KILLS and MDMS_HOST_KILLS set other numbers. Clients
give an order, and give it again until it is acknowledged. No order that was acknowledged may be
lost, none may be accepted twice, and none may be repeated by itself.
"""

import os
import signal
import socket
import struct
import time
from contextlib import suppress
from multiprocessing import get_context
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

from tests.system.line.controller import STOPPED, Table

from mdms_host.line.order_book import OrderBook
from mdms_host.programs.table_orders import LineOrder, OrderState

KILLS = int(os.environ.get("MDMS_KILLS", "1000"))
HOST_KILLS = int(os.environ.get("MDMS_HOST_KILLS", "20"))
#: Orders between two kills, at most.
ORDERS = 20
_ACCEPTED, _IN_DOUBT, _CANCELLED = 1, 7, 6
_ORDER, _CANCEL, _ASK = 0, 1, 3


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
    lost = twice = repeated = in_doubt = 0
    with TemporaryDirectory() as folder:
        table = Table(Path(folder), ("modbus",))
        table.start()
        for kill in range(HOST_KILLS):
            controller = table.controller()
            for key in sorted(given):
                result, state = controller.order(_ASK, key)
                lost += result != 0
                repeated += state not in (_ACCEPTED, _IN_DOUBT, _CANCELLED, 3, 4, 5)
                in_doubt += state == _IN_DOUBT
            assert controller.read(1) == (STOPPED,)
            for number in range(random.randrange(1, ORDERS)):
                key = f"{kill}-{number}"
                if number == 0:
                    controller.order(2, "", f"P{key}")
                assert controller.order(_ORDER, key, f"P{key}", exit=2) == (0, 1)
                twice += controller.order(_ORDER, key, f"P{key}", exit=2)[0] != 1
                given.add(key)
            controller.bring_to_execute()
            end_s = time.monotonic() + random.uniform(0.0, 3.0)
            while time.monotonic() < end_s:
                controller.beat()
                time.sleep(0.05)
            table.kill()
            with suppress(OSError):
                controller.close()
            table.start()
        controller = table.controller()
        states = [controller.order(_ASK, key)[1] for key in sorted(given)]
        assert table.process is not None
        table.process.send_signal(signal.SIGTERM)
        table.process.communicate()
    return {
        "name": f"whole hosts killed {HOST_KILLS} times: lost, twice or repeated",
        "ours": lost + twice + repeated,
        "unit": "orders",
        "failed": bool(lost or twice or repeated),
        "orders": len(given),
        "in_doubt": states.count(_IN_DOUBT),
        "seen_in_doubt": in_doubt,
    }
