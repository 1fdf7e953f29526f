"""Boxes whose ways cross while frames get lost: do they touch?

Two on 9 x 6 cells over three buses, four on 12 x 10 over eight, each from a corner to the opposite
one. A box that has not arrived within 5 mm and 2 degrees is to stand, and a cell under it to report
that it lacks a promise, or (`cut_off`) that its host's heartbeat was lost. `bound` is the upper end
of a one-sided confidence interval of the share of cases in which boxes touch. `MDMS_CASES` is the
number of cases for each share of loss (default 3), `MDMS_SEED` the first seed (default 1),
`MDMS_BOXES` how many boxes (2 or 4; default: both). Two take some 5 s a case, four some 20 s.
"""

import os
from collections.abc import Sequence
from random import Random
from typing import Any, NamedTuple

from tests.benchmarks.cells.neighbours import CONFIDENCE, at_least
from tests.system.cells.neighbour_host import Box, Run, scenario_of
from tests.system.cells.neighbour_host import run as run_cells

#: Columns and rows of the table for so many boxes, and when a case ends.
TABLES = {2: (9, 6), 4: (12, 10)}
LIMIT_S = {2: 16.0, 4: 24.0}
SPEED_M_S = 0.2
LOSSES = (0.0, 0.02, 0.10)


class Crossing(NamedTuple):
    """The outcome of a case; `held` and `cut_off` are boxes that stand, and cells report why."""

    touches: int
    arrived: int
    held: int
    cut_off: int
    neither: int


def boxes_of(boxes: int, seed: int) -> Sequence[Box]:
    """Boxes whose ways cross while their ends lie apart."""
    return two_of(seed) if boxes == 2 else four_of(seed)


def two_of(seed: int) -> tuple[Box, Box]:
    """Two boxes, each from a corner to the opposite one."""
    random = Random(f"crossing {seed}")
    along = [random.uniform(0.20, 0.40) for _ in range(4)]
    across = [random.uniform(0.19, 0.22) for _ in range(4)]
    way = random.choice((1, -1))
    first = Box((-along[0], -across[0], 0.0), (along[1], across[1], 0.0))
    second = Box((-way * along[2], across[2], 0.0), (way * along[3], -across[3], 0.0))
    return first._replace(speed_m_s=SPEED_M_S), second._replace(speed_m_s=SPEED_M_S)


def four_of(seed: int) -> list[Box]:
    """Four boxes, each from a corner to the opposite one, so that all meet in the middle."""
    random = Random(f"crossing of four {seed}")
    boxes = []
    for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
        start_m, goal_m = [
            (random.uniform(0.30, 0.58), random.uniform(0.25, 0.45)) for _ in range(2)
        ]
        start = (x * start_m[0], y * start_m[1], 0.0)
        goal = (-x * goal_m[0], -y * goal_m[1], 0.0)
        boxes.append(Box(start, goal, speed_m_s=SPEED_M_S))
    return boxes


def case(boxes: int, seed: int, loss: float) -> Crossing:
    """One crossing."""
    sent = boxes_of(boxes, seed)
    faults = [f"{{kind='loss', probability={loss}, start_s=1.5}}"] if loss else []
    scenario = scenario_of(sent, *TABLES[boxes], seed=seed, faults=faults)
    finished = run_cells(scenario, sent, LIMIT_S[boxes], still_after_s=3.0)
    ended = [how_it_ended(finished, box) for box in range(boxes)]
    return Crossing(finished.touches, *(ended.count(how) for how in Crossing._fields[1:]))


def how_it_ended(finished: Run, box: int) -> str:
    """The outcome of a box, in a word."""
    if finished.arrived(box):
        return "arrived"
    if finished.stands(box) and finished.is_held(box):
        return "held"
    return "cut_off" if finished.stands(box) and finished.is_cut_off(box) else "neither"


def row(boxes: int, loss: float, seeds: range) -> dict[str, Any]:
    """The cases of so many boxes and one share of loss."""
    ended = []
    for seed in seeds:
        ended.append(case(boxes, seed, loss))
        print(f"  {boxes} boxes, {loss:.0%} lost, seed {seed}: {ended[-1]}", flush=True)
    apart = sum(not one.touches for one in ended)
    return {
        "name": f"crossings of {boxes} that touch, {loss:.0%} of frames lost",
        "ours": 100 * (len(ended) - apart) / len(ended),
        "peer": None,
        "ratio": None,
        "unit": "%",
        "bound": 100 * (1 - at_least(apart, len(ended))),
        "cases": len(ended),
        "boxes_arrived": sum(one.arrived for one in ended),
        "boxes_held": sum(one.held for one in ended),
        "boxes_cut_off": sum(one.cut_off for one in ended),
        "boxes_neither": sum(one.neither for one in ended),
    }


def run() -> list[dict[str, Any]]:
    """A row for each number of boxes and share of loss."""
    cases = int(os.environ.get("MDMS_CASES", "3"))
    first = int(os.environ.get("MDMS_SEED", "1"))
    print(
        f"MDMS_CASES={cases} MDMS_SEED={first} python -m tests.benchmarks crossing: seeds {first} "
        f"to {first + cases - 1}; bounds one-sided, {CONFIDENCE:.0%}",
        flush=True,
    )
    counts = [int(os.environ["MDMS_BOXES"])] if "MDMS_BOXES" in os.environ else [*TABLES]
    seeds = range(first, first + cases)
    return [row(boxes, loss, seeds) for boxes in counts for loss in LOSSES]
