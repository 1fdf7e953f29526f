"""Two boxes whose ways cross on 9 x 6 cells over three buses, while frames get lost: do they touch?

Each goes from a corner to the opposite one. A box that has not arrived within 5 mm and 2 degrees is
to stand, and a cell under it to report that it lacks a promise. `bound` is the upper end of a one-
sided confidence interval of the share of cases in which the boxes touch. `MDMS_CASES` is the number
of cases for each share of loss (default 3), `MDMS_SEED` the first seed (default 1).
"""

import os
from random import Random
from typing import Any, NamedTuple

from tests.benchmarks.cells.neighbours import CONFIDENCE, at_least
from tests.system.cells.neighbour_host import Box, scenario_of
from tests.system.cells.neighbour_host import run as run_cells

COLUMNS, ROWS = 9, 6
LIMIT_S = 16.0
SPEED_M_S = 0.2
LOSSES = (0.0, 0.02, 0.10)


class Crossing(NamedTuple):
    """What came of a case; `held` are boxes that stand and say that they lack a promise."""

    touches: int
    arrived: int
    held: int
    silent: int


def boxes_of(seed: int) -> tuple[Box, Box]:
    """Two boxes, each from a corner to the opposite one: their ways cross, their ends lie apart."""
    random = Random(f"crossing {seed}")
    along = [random.uniform(0.20, 0.40) for _ in range(4)]
    across = [random.uniform(0.19, 0.22) for _ in range(4)]
    way = random.choice((1, -1))
    first = Box((-along[0], -across[0], 0.0), (along[1], across[1], 0.0))
    second = Box((-way * along[2], across[2], 0.0), (way * along[3], -across[3], 0.0))
    return first._replace(speed_m_s=SPEED_M_S), second._replace(speed_m_s=SPEED_M_S)


def case(seed: int, loss: float) -> Crossing:
    """One crossing."""
    boxes = boxes_of(seed)
    faults = [f"{{kind='loss', probability={loss}, start_s=1.5}}"] if loss else []
    scenario = scenario_of(boxes, COLUMNS, ROWS, seed=seed, faults=faults)
    finished = run_cells(scenario, boxes, LIMIT_S, still_after_s=3.0)
    arrived = [finished.arrived(box) for box in (0, 1)]
    held = [not arrived[box] and finished.stands(box) and finished.is_held(box) for box in (0, 1)]
    return Crossing(finished.touches, sum(arrived), sum(held), 2 - sum(arrived) - sum(held))


def row(loss: float, seeds: range) -> dict[str, Any]:
    """The cases of one share of loss."""
    ended = []
    for seed in seeds:
        ended.append(case(seed, loss))
        print(f"  {loss:.0%} lost, seed {seed}: {ended[-1]}", flush=True)
    apart = sum(not one.touches for one in ended)
    return {
        "name": f"crossings that touch, {loss:.0%} of frames lost",
        "ours": 100 * (len(ended) - apart) / len(ended),
        "peer": None,
        "ratio": None,
        "unit": "%",
        "bound": 100 * (1 - at_least(apart, len(ended))),
        "cases": len(ended),
        "boxes_arrived": sum(one.arrived for one in ended),
        "boxes_held": sum(one.held for one in ended),
        "boxes_neither": sum(one.silent for one in ended),
    }


def run() -> list[dict[str, Any]]:
    """A row for each share of loss."""
    cases = int(os.environ.get("MDMS_CASES", "3"))
    first = int(os.environ.get("MDMS_SEED", "1"))
    print(
        f"MDMS_CASES={cases} MDMS_SEED={first} python -m tests.benchmarks crossing: seeds {first} "
        f"to {first + cases - 1}; bounds one-sided, {CONFIDENCE:.0%}",
        flush=True,
    )
    return [row(loss, range(first, first + cases)) for loss in LOSSES]
