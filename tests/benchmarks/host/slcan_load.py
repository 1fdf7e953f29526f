"""Runs over each way into a served array while cores are kept busy: which share ends as it should.

`python -m tests.benchmarks.host.slcan_load [--runs N] [--busy K ...] [--ways mdms terminal tcp]`
starts K programs that do nothing but compute, and ends them. Each run carries the demo's box to
its goal; one that faults names a delay of this machine as the reason, or something else. The
machine's load average stands beside the shares, for other programs keep cores busy too.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from math import comb
from tempfile import TemporaryDirectory

from tests.system.links.served_array import Served, serve

RUNS = 12
LIMIT_S = 40
WAYS = ("mdms", "terminal", "tcp")
#: An idle machine, one busy core, and all of them.
BUSY = tuple(sorted({0, 1, os.cpu_count() or 1}))
CONFIDENCE = 0.95
#: The text of a fault whose reason is a delay of the computer.
DELAYED = ("held up", "too busy or too slow")
DONE, DELAY, OTHER = "done", "fault by a delay", "other"


@contextmanager
def busy_cores(count: int) -> Iterator[None]:
    """So many programs that compute meanwhile."""
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


def at_least(good: int, runs: int) -> float:
    """The share that is exceeded with 95 % confidence when `good` of `runs` were (exact)."""
    low, high = 0.0, good / runs
    for _ in range(40):
        share = (low + high) / 2
        as_many = sum(
            comb(runs, k) * share**k * (1 - share) ** (runs - k) for k in range(good, runs + 1)
        )
        low, high = (share, high) if as_many < 1 - CONFIDENCE else (low, share)
    return low


def options(array: Served, way: str) -> tuple[str, ...]:
    """python-can's options for a way into the array."""
    if way == "mdms":
        return ("-i", "mdms", "-c", array.channel)
    channel = array.device if way == "terminal" else array.tcp
    return ("-i", "slcan", "-c", channel, "-b", "1000000")


def outcome(way: str) -> tuple[str, str]:
    """How a run on an array of its own ends, and its fault."""
    with TemporaryDirectory() as folder:
        array = serve(folder)
        try:
            done = array.run(
                *("mdms", "run", "array18", "--limit", LIMIT_S, "--json", *options(array, way)),
                timeout=4 * LIMIT_S,
            )
        finally:
            array.stop()
    if done.returncode == 0:
        return DONE, ""
    fault = json.loads(done.stdout)["fault"] if done.stdout else done.stderr.strip()
    return (DELAY if any(text in str(fault) for text in DELAYED) else OTHER), str(fault)


def figures(way: str, busy: int, runs: int) -> dict[str, object]:
    """One row of the table."""
    ends: Counter[str] = Counter()
    with busy_cores(busy):
        for _ in range(runs):
            end, fault = outcome(way)
            ends[end] += 1
            if fault:
                print(f"  {way}, {busy} busy: {fault}", flush=True)
        load = os.getloadavg()[0]
    return {
        "name": f"runs over {way} that end well, {busy} of {os.cpu_count()} cores busy",
        "ours": ends[DONE] / runs,
        "unit": "share",
        "at_least": at_least(ends[DONE], runs),
        "of": runs,
        "faults_by_delay": ends[DELAY],
        "others": ends[OTHER],
        "load_average": load,
    }


def run() -> list[dict[str, object]]:
    """All ways under all loads."""
    return [figures(way, busy, RUNS) for busy in BUSY for way in WAYS]


def main() -> None:
    """The table for other numbers than the benchmarks' own."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.slcan_load")
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("--busy", type=int, nargs="+")
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=WAYS)
    told = parser.parse_args()
    # Started processes end with this, however it ends.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    for busy in told.busy if told.busy is not None else BUSY:
        for way in told.ways:
            row = figures(way, busy, told.runs)
            print("  ".join(f"{key}={value}" for key, value in row.items()), flush=True)


if __name__ == "__main__":
    main()
