"""200 orders on a simulated `sort54`, with full chutes, a lost heartbeat and an emergency stop.

`python -m tests.benchmarks line_orders` runs in virtual time; MDMS_ORDERS sets another number. Each
parcel is announced by a scanner and has an order to a random exit. In the end the truth must agree
with the reports: each parcel left once, by the exit of its order. An order that was under way at
the stop is in doubt, and is not counted as done. After the stop a person takes the parcels off that
lie on the table, and those whose orders are open are announced again.
"""

import os
from collections import Counter
from random import Random
from time import perf_counter
from typing import Any

from tests.host.line.virtual_line import VirtualLine

from mdms_host.line.packml import Command, State
from mdms_model.run.record import exit_of

ORDERS = int(os.environ.get("MDMS_ORDERS", "200"))
#: Virtual time for each order before this gives up [s].
PATIENCE_S = 8.0
_CLOSED = ("left", "refused", "in doubt", "lost")


def run() -> list[dict[str, Any]]:
    """One run."""
    random, began_s = Random(5), perf_counter()
    with VirtualLine(source="sort54") as line:
        exits = line.machine.exits
        wanted = {f"o{number}": random.choice(exits) for number in range(ORDERS)}
        for number, (key, exit) in enumerate(wanted.items()):
            parcel = f"P-{number}"
            line.do("coming", parcel=parcel, kind="")
            line.do("order", order={"key": key, "parcel": parcel, "exit": exit})
        line.bring_to_execute()
        troubles = [
            (0.25, lambda: _fill(line, exits[0])),
            (0.5, lambda: _lose_heartbeat(line)),
            (0.75, lambda: _stop(line)),
        ]
        while (done := _done(line)) < ORDERS and line.now_s() < PATIENCE_S * ORDERS:
            if line.state is State.SUSPENDED and "no parcel comes" in line.machine.states.reason:
                break
            if troubles and done >= troubles[0][0] * ORDERS:
                troubles.pop(0)[1]()
            line.pass_s(0.1)
        return _rows(line, wanted, perf_counter() - began_s)


def _done(line: VirtualLine) -> int:
    return len({each.key for each in line.reports if each.key and each.event in _CLOSED})


def _fill(line: VirtualLine, exit: str) -> None:
    line.do("exit", exit=exit, full=True)
    line.pass_s(10.0)
    line.do("exit", exit=exit, full=False)


def _lose_heartbeat(line: VirtualLine) -> None:
    line.beats = False
    line.until_state(State.SUSPENDED)
    line.pass_s(1.0)
    line.beats = True
    line.command(Command.UNSUSPEND)
    line.until_state(State.EXECUTE)


def _stop(line: VirtualLine) -> None:
    line.command(Command.ABORT)
    line.until_state(State.ABORTED)
    line.pass_s(2.0)
    line.command(Command.CLEAR)
    line.until_state(State.STOPPED)
    line.take_parcels_off()
    line.command(Command.RESET)
    line.until_state(State.IDLE)
    # The stop has ended all announcements.
    for order in line.machine.orders.open.values():
        line.do("coming", parcel=order.parcel, kind="")
    line.command(Command.START)
    line.until_state(State.EXECUTE)


def _rows(line: VirtualLine, wanted: dict[str, str], took_s: float) -> list[dict[str, Any]]:
    ends = Counter(each.event for each in line.reports if each.key and each.event in _CLOSED)
    left = [each for each in line.reports if each.event == "left"]
    by_order = [each for each in left if each.key]
    twice = len(by_order) - len({each.key for each in by_order})
    wrong = sum(each.exit != wanted[each.key] for each in by_order)
    true = Counter(exit_of(e) for e in line.simulation.world.events if e.kind == "exit")
    told = Counter(each.exit for each in left)
    return [
        {
            "name": f"{len(wanted)} orders on sort54: done",
            "ours": len(by_order) - wrong - twice,
            "peer": len(wanted),
            "ratio": len(by_order) / len(wanted),
            "unit": "orders",
            "failed": bool(wrong or twice or true != told),
            "open": len(line.machine.orders.open),
            "in_doubt": ends["in doubt"],
            "refused": ends["refused"],
            "twice": twice,
            "wrong_exit": wrong,
            "true_minus_told": sum(((true - told) + (told - true)).values()),
            "virtual_s": line.now_s(),
            "took_s": took_s,
            "last_state": f"{line.state.name} {line.machine.states.reason}".strip(),
        }
    ]
