"""How evenly `mdms run` sends setpoints: with both servers of a line under load, and without.

`python -m tests.benchmarks line_jitter`; MDMS_TURNS sets another even number of turns. A box goes
back and forth on 18 served cells. The two ways take turns of a few seconds, since other work of the
machine is in both. A client of each protocol asks again and again: Modbus each 5 ms, OPC UA each
10 ms. They stand for other machines, so they leave this one's processors to host and servers. The
jitter is how far two setpoints of a cell are off the cycle. The goal is a ratio of 1.1. One way
alone differs by half from turn to turn, so a few turns cannot tell; `low` and `high` are the bounds
of the ratio (95 %, by bootstrap over pairs of turns).
"""

import asyncio
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from tests.benchmarks.host.real_time import BACK_AND_FORTH
from tests.system.line.controller import EXECUTE, IDLE, PATIENCE_S, Controller, admit_user
from tests.system.line.opcua import opcua_client
from tests.system.links.served_array import Served, serve

from mdms_host.can_link.link import Link
from mdms_host.cli import main
from mdms_model.scenario.file import load_scenario
from mdms_protocol import pdo

TURNS = int(os.environ.get("MDMS_TURNS", "24"))
#: A turn is looked at for so long, after so long of driving [s].
LOOK_S, AFTER_S = 8.0, 2.0
GOAL = 1.1
MODBUS_S, OPCUA_S = 0.005, 0.01
_SETPOINT = pdo.TARGET_VELOCITY.can_id(1)
_SHARES = (50, 95, 99)
_DRAWS = 10_000


def run() -> list[dict[str, Any]]:
    """A row for each percentile of the jitter: medians over the turns."""
    cycle_s = load_scenario("array18", BACK_AND_FORTH).wire.sync_period_s
    plain, asked, answers = [], [], []
    with TemporaryDirectory() as folder:
        admit_user(Path(folder))
        array = serve(folder, *_set())
        try:
            # Each begins as often, so what drifts is in both.
            for with_line in [False, True, True, False] * (TURNS // 2):
                if not with_line:
                    plain.append(_percentiles_ms(_turn(array), cycle_s))
                    continue
                sent_s, count = _turn_of_line(array, Path(folder))
                asked.append(_percentiles_ms(sent_s, cycle_s))
                answers.append(count / LOOK_S)
        finally:
            array.stop()
    notes = {"answers_a_second": median(answers), "load_average": os.getloadavg()[0]}
    return [
        _row(share, ours, peers) | notes
        for share, ours, peers in zip(
            _SHARES, zip(*asked, strict=True), zip(*plain, strict=True), strict=True
        )
    ]


def _row(share: int, ours: tuple[float, ...], peers: tuple[float, ...]) -> dict[str, Any]:
    drawn = np.random.default_rng(1).integers(len(ours), size=(_DRAWS, len(ours)))
    ratios = np.median(np.array(ours)[drawn], 1) / np.median(np.array(peers)[drawn], 1)
    low, high = np.percentile(ratios, (2.5, 97.5))
    return {
        "name": f"jitter of setpoints, {share}th percentile",
        "ours": median(ours),
        "peer": median(peers),
        "ratio": median(ours) / median(peers),
        "unit": "ms",
        "goal": GOAL,
        "turns": len(ours),
        "low": float(low),
        "high": float(high),
    }


def _set() -> list[str]:
    return [part for text in BACK_AND_FORTH for part in ("--set", text)]


def _percentiles_ms(sent_s: list[float], cycle_s: float) -> list[float]:
    """The jitter within the window of a turn."""
    return list(np.percentile(1e3 * abs(np.diff(sent_s) - cycle_s), _SHARES))


# The host ----------------------------------------------------------------------------------------


def host(arguments: list[str]) -> None:
    """`mdms run` in a process of its own: prints when it sent the setpoints of a cell."""
    sent_s: list[float] = []
    send = Link.send

    def timed(self: Link, frame: Any, until_s: float | None = None) -> None:
        send(self, frame, until_s)
        if frame.can_id == _SETPOINT:
            sent_s.append(time.monotonic())

    Link.send = timed  # type: ignore[method-assign]
    main(arguments)
    print(json.dumps(sent_s))


def _begin(array: Served, *options: str) -> "subprocess.Popen[str]":
    code = f"from {__name__} import host; import sys; host(sys.argv[1:])"
    command = ["run", "array18", *_set(), "-i", "mdms", "-c", array.channel, *options]
    return subprocess.Popen(
        [sys.executable, "-c", code, *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=array.environment,
    )


def _turn(array: Served) -> list[float]:
    """Without servers."""
    process = _begin(array, "--limit", str(LOOK_S + 2 * AFTER_S + 4.0))
    sent_s = json.loads(process.communicate(timeout=PATIENCE_S)[0].splitlines()[-1])
    return _window(sent_s, sent_s[0] + AFTER_S)


def _window(sent_s: list[float], from_s: float) -> list[float]:
    return [each for each in sent_s if from_s <= each < from_s + LOOK_S]


def _turn_of_line(array: Served, folder: Path) -> tuple[list[float], int]:
    """With both servers, and clients that ask; also how many answers they got."""
    process = _begin(array, "--modbus", "0", "--opcua", "0", "--state", str(folder))
    assert process.stdout is not None
    port, url = (process.stdout.readline().strip() for _ in range(2))
    controller = Controller(int(port.rpartition(":")[2]))
    controller.command(1)
    controller.until_state(IDLE)
    controller.command(2)
    controller.until_state(EXECUTE)
    from_s = time.monotonic() + AFTER_S
    until_s = from_s + LOOK_S + 0.5
    context = get_context("spawn")
    counts = context.SimpleQueue()
    clients = [
        context.Process(target=_ask, args=(_by_opcua, (url, str(folder)), from_s, until_s, counts)),
        context.Process(target=_ask, args=(_by_modbus, (port,), from_s, until_s, counts)),
    ]
    for each in clients:
        each.start()
    while time.monotonic() < until_s:
        controller.beat()
        time.sleep(0.2)
    for each in clients:
        each.join()
    controller.close()
    process.terminate()
    said = process.communicate(timeout=PATIENCE_S)[0]
    sent_s = json.loads(said.splitlines()[-1])
    return _window(sent_s, from_s), counts.get() + counts.get()


# The clients -------------------------------------------------------------------------------------


def _ask(
    by: Callable[..., int], where: tuple[str, ...], from_s: float, until_s: float, counts: Any
) -> None:
    os.nice(19)
    counts.put(by(*where, from_s, until_s))


def _by_modbus(address: str, from_s: float, until_s: float) -> int:
    """Read the first registers each 5 ms; returns how often within the time."""
    controller, count = Controller(int(address.rpartition(":")[2])), 0
    while (now_s := time.monotonic()) < until_s:
        controller.read(0, 20)
        count += now_s >= from_s
        time.sleep(MODBUS_S)
    controller.close()
    return count


def _by_opcua(url: str, folder: str, from_s: float, until_s: float) -> int:
    """The same with ten variables of `Line`, each 10 ms."""
    return asyncio.run(_reading(url, Path(folder), from_s, until_s))


async def _reading(url: str, folder: Path, from_s: float, until_s: float) -> int:
    count = 0
    async with await opcua_client(url, folder) as client:
        index = await client.get_namespace_index("urn:mdms-array:line")
        line = await client.nodes.objects.get_child([f"{index}:Table", f"{index}:Line"])
        nodes = (await line.get_variables())[:10]
        while (now_s := time.monotonic()) < until_s:
            await client.read_values(nodes)
            count += now_s >= from_s
            await asyncio.sleep(OPCUA_S)
    return count
