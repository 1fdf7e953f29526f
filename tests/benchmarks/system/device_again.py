"""An adapter and a served bus go away at random instants of a run, and come back: 100 times.

`python -m tests.benchmarks device_again` closes a pseudo-terminal 50 times and the socket of a
served bus 50 times. After each return nothing may move before Clear, Reset and Start, by the
simulator's wheels. MDMS_TIMES sets another number.
"""

import os
from pathlib import Path
from random import Random
from statistics import median
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

from tests.system.links.going_away import Plant

TIMES = int(os.environ.get("MDMS_TIMES", "100"))


def run() -> list[dict[str, Any]]:
    """One row for each way in."""
    return [_row(interface, max(1, TIMES // 2)) for interface in ("mdms", "slcan")]


def _row(interface: str, times: int) -> dict[str, Any]:
    random, took_s, moved = Random(1), [], 0
    with TemporaryDirectory() as folder, Plant(Path(folder), interface) as plant:
        for _ in range(times):
            began_s = perf_counter()
            try:
                plant.goes_and_comes_back(random.uniform(0.0, 2.0), random.uniform(0.0, 1.5))
            except AssertionError:
                moved += 1
            took_s.append(perf_counter() - began_s)
        back = sum("is there again" in line for line in plant.said)
    return {
        "name": f"{interface}: device gone and back {times} times",
        "ours": back,
        "peer": times,
        "ratio": back / times,
        "unit": "times",
        "failed": moved > 0 or back != times,
        "other_ends": moved,
        "median_s": median(took_s),
    }
