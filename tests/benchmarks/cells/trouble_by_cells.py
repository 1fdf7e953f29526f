"""Something breaks under a box that its cells steer: the rows of docs/faults.md, at any instant.

Each row runs with seeds of motors and friction and with its fault at an instant that is drawn by
seed, while the box is on its way. It ended as documented if the run ended with the exit code, the
pauses and the lost cells of its row, touched nothing, reported its messages, and turned no wheel
that was to stand (`moved_mm_s`) or that no parcel lay on (`strayed_mm_s`). `reached` counts the
boxes that are within 5 mm and 2 degrees of their goal by truth. `MDMS_CASES` is the number of cases
of each row (default 3), `MDMS_SEED` the first seed (default 1), `MDMS_KINDS` names the rows, parted
by semicolons; a case takes some 3 s.
"""

import os
import re
from math import hypot, remainder, tau
from random import Random
from typing import Any

from tests.benchmarks.cells.neighbours import CONFIDENCE, at_least
from tests.system.trouble.documented import messages
from tests.system.trouble.rows_by_cells import (
    GOAL,
    HEADING,
    ROWS,
    STANDS_M_S,
    Ended,
    Row,
    run_row,
)

#: A fault begins between these times; the box moves from 0.5 s on, and needs two.
FIRST_S, LAST_S = 0.8, 1.8


def defects(row: Row, ended: Ended) -> list[str]:
    """The differences from the documented outcome."""
    found = []
    if ended.ends not in (row.ends, *row.otherwise):
        found.append(f"ended with {ended.ends.name}")
    if ended.run.pauses not in row.pauses or ended.run.lost_cells != row.lost:
        found.append(f"{ended.run.pauses} pauses, lost {ended.run.lost_cells}")
    if ended.touches:
        found.append(f"{ended.touches} touches")
    patterns = messages(HEADING)[row.what] if ended.ends is row.ends else []
    found += [f"no '{each}'" for each in patterns if not re.search(each, ended.texts)]
    found += [
        f"{what} {1e3 * speed_m_s:.0f} mm/s"
        for what, speed_m_s in (("moved", ended.moved_m_s), ("strayed", ended.strayed_m_s))
        if speed_m_s >= STANDS_M_S
    ]
    return found


def reached(ended: Ended) -> bool:
    """Whether the box lies at its goal, by truth."""
    x_m, y_m, yaw_rad = ended.run.record.pose[-1, 0]
    goal_x_m, goal_y_m, goal_yaw_rad = GOAL
    off_m = hypot(x_m - goal_x_m, y_m - goal_y_m)
    return off_m < 0.005 and abs(remainder(yaw_rad - goal_yaw_rad, tau)) < 2 * tau / 360


def run_kind(row: Row, seeds: range) -> dict[str, Any]:
    """A row: the share of runs that ended as documented."""
    wrong, there, moved_m_s, strayed_m_s = {}, 0, 0.0, 0.0
    for seed in seeds:
        ended = run_row(row, Random(f"{row.what} {seed}").uniform(FIRST_S, LAST_S), seed)
        there += reached(ended)
        moved_m_s = max(moved_m_s, ended.moved_m_s)
        strayed_m_s = max(strayed_m_s, ended.strayed_m_s)
        if found := defects(row, ended):
            wrong[seed] = ", ".join(found)
    well = len(seeds) - len(wrong)
    return {
        "name": f"{row.what}: ended as documented",
        "ours": 100 * well / len(seeds),
        "peer": None,
        "ratio": None,
        "unit": "%",
        "bound": 100 * at_least(well, len(seeds)),
        "cases": len(seeds),
        "reached": there,
        "moved_mm_s": 1e3 * moved_m_s,
        "strayed_mm_s": 1e3 * strayed_m_s,
        "wrong": "; ".join(f"{seed}: {what}" for seed, what in wrong.items()) or None,
    }


def run() -> list[dict[str, Any]]:
    """A row for each row of the table."""
    cases = int(os.environ.get("MDMS_CASES", "3"))
    first = int(os.environ.get("MDMS_SEED", "1"))
    kinds = [kind for kind in os.environ.get("MDMS_KINDS", "").split(";") if kind]
    print(
        f"MDMS_CASES={cases} MDMS_SEED={first} python -m tests.benchmarks trouble_by_cells: seeds "
        f"{first} to {first + cases - 1}; bounds one-sided, {CONFIDENCE:.0%}",
        flush=True,
    )
    table = []
    for row in ROWS:
        if not kinds or row.what in kinds:
            table.append(run_kind(row, range(first, first + cases)))
            print(f"  {table[-1]}", flush=True)
    return table
