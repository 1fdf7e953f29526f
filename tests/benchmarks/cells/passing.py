"""Two boxes pass each other on 9 x 6 cells over three buses: do they keep their identities?

20 to 40 mm are between them, and each goes in a lane of its own that ends at a border of cells, at
0.1 to 0.2 m/s. A swap is an estimate on the bus with a box's identity whose pose is nearer to the
other box, or a box that ends at the other's goal. `bound` is the upper end of a one-sided
confidence interval of the share of passes with a swap or a touch. `MDMS_CASES` is the number of
passes (default 5), `MDMS_SEED` the first seed (default 1). A pass takes some 5 s, nearly
all of it the cells' own work: a world without inertia (`ideal`) would save a fiftieth.
"""

import os
from math import hypot
from random import Random
from typing import Any, NamedTuple

from tests.benchmarks.cells.neighbours import CONFIDENCE, at_least
from tests.system.cells.neighbour_host import Box, Run, scenario_of
from tests.system.cells.neighbour_host import run as run_cells

from mdms_protocol.neighbours import frames as wire

COLUMNS, ROWS = 9, 6
SIZE_M = 0.28
LIMIT_S = 12.0
SAMPLE_S = 0.01


class Pass(NamedTuple):
    """The outcome of a pass."""

    swaps: int
    touches: int
    arrived: bool
    estimates: int


def boxes_of(seed: int) -> tuple[Box, Box]:
    """Two boxes that are to change sides."""
    random = Random(f"pass {seed}")
    off_m = (SIZE_M + random.uniform(0.020, 0.040)) / 2
    from_m, to_m = random.uniform(0.17, 0.25), random.uniform(0.17, 0.25)
    upper = Box((-from_m, off_m, 0.0), (to_m, off_m, 0.0), speed_m_s=random.uniform(0.1, 0.2))
    lower = Box((to_m, -off_m, 0.0), (-from_m, -off_m, 0.0), speed_m_s=random.uniform(0.1, 0.2))
    return upper, lower


def case(seed: int) -> Pass:
    """One pass."""
    boxes = boxes_of(seed)
    spread = ("cell.motor_spread=0.3", "cell.friction_spread=0.3")
    scenario = scenario_of(boxes, COLUMNS, ROWS, seed=seed, overrides=spread)
    finished = run_cells(scenario, boxes, LIMIT_S, still_after_s=2.0)
    swapped = swaps(finished) + sum(ends_at_the_others(finished, box) for box in (0, 1))
    arrived = all(finished.arrived(box) for box in (0, 1))
    return Pass(swapped, finished.touches, arrived, len(finished.host.estimates))


def swaps(finished: Run) -> int:
    """How many estimates with a pose lie nearer to the other box."""
    host, pose = finished.host, finished.record.pose
    count = 0
    for heard in host.estimates:
        own = heard.fields[wire.IDENTITY] - 1
        if own in (0, 1) and heard.fields[wire.CERTAINTY]:
            true = pose[min(round(heard.time_s / SAMPLE_S), len(pose) - 1)]
            x_m, y_m, _ = host.pose(heard)
            off_m = [hypot(x_m - true[box, 0], y_m - true[box, 1]) for box in (0, 1)]
            count += off_m[own] > off_m[1 - own]
    return count


def ends_at_the_others(finished: Run, box: int) -> bool:
    """Whether a box ends nearer to the other's goal."""
    x_m, y_m, _ = finished.record.pose[-1, box]
    goals = [one.goal for one in finished.host.boxes]
    off_m = [hypot(x_m - goal[0], y_m - goal[1]) for goal in goals]
    return off_m[box] > off_m[1 - box]


def run() -> list[dict[str, Any]]:
    """One row."""
    cases = int(os.environ.get("MDMS_CASES", "5"))
    first = int(os.environ.get("MDMS_SEED", "1"))
    print(
        f"MDMS_CASES={cases} MDMS_SEED={first} python -m tests.benchmarks passing: seeds {first} "
        f"to {first + cases - 1}; bounds one-sided, {CONFIDENCE:.0%}",
        flush=True,
    )
    passes = []
    for seed in range(first, first + cases):
        passes.append(case(seed))
        print(f"  seed {seed}: {passes[-1]}", flush=True)
    well = sum(not (one.swaps or one.touches) for one in passes)
    return [
        {
            "name": "passes with a swap or a touch",
            "ours": 100 * (cases - well) / cases,
            "peer": None,
            "ratio": None,
            "unit": "%",
            "bound": 100 * (1 - at_least(well, cases)),
            "cases": cases,
            "swaps": sum(one.swaps for one in passes),
            "touches": sum(one.touches for one in passes),
            "both_arrived": sum(one.arrived for one in passes),
            "estimates": sum(one.estimates for one in passes),
        }
    ]
