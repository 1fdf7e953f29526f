"""One cell is broken while a box is on its way: it arrives, or all stands, or it fails.

Start and goal poses on 6 x 3 cells are those of `neighbours`, the cell and the instant are drawn by
seed. A box has arrived within 5 mm and 2 degrees; it stands safely if it is at rest elsewhere, and
most cells under it do not report that it is at its goal. Everything else has failed. `bound` is the
lower end of a one-sided confidence interval of what did not fail. `MDMS_CASES` is the number of
cases of each kind (default 5), `MDMS_SEED` the first seed (default 1), `MDMS_KINDS` names the
kinds.
"""

import os
from random import Random
from typing import Any, NamedTuple

from tests.benchmarks.cells.neighbours import CELLS, CONFIDENCE, at_least, scenario_of
from tests.system.cells.neighbour_host import Box, Run
from tests.system.cells.neighbour_host import run as run_cells

LIMIT_S = 12.0
#: The fault begins between these times; boxes begin to move at about 1.0 s.
FIRST_S, LAST_S = 1.1, 3.0
#: A watchdog bites after so long, and a cell boots in the other.
WATCHDOG_S, BOOT_S = 0.27, 0.05
FAULTS = {
    "dead": "kind='off'",
    "hung": f"kind='hang', duration_s={WATCHDOG_S}",
    "rebooting": f"kind='off', duration_s={BOOT_S}",
    "presence stuck on": "kind='sensor_stuck', covered=true",
    "presence stuck off": "kind='sensor_stuck', covered=false",
    "encoder stuck": "kind='encoder_stuck'",
    "motor reversed": "kind='motor_reversed'",
    "wheel jammed": "kind='wheel_jammed'",
    "wrong place": None,
}


class Case(NamedTuple):
    """The outcome of a case, and whether a neighbour has named the cell."""

    ended: str
    named: bool


def case(kind: str, seed: int) -> Case:
    """One cell has a fault of this kind."""
    random = Random(f"{kind} {seed}")
    cell, other = random.sample(range(1, CELLS + 1), 2)
    start_s = random.uniform(FIRST_S, LAST_S)
    fault = FAULTS[kind]
    struck = [f"fault=[{{{fault}, cells=[{cell}], start_s={start_s}}}]"] if fault else []
    scenario = scenario_of(seed, *struck)
    parcel = scenario.parcel[0]
    assert parcel.goal is not None
    box = Box(
        (parcel.x_m, parcel.y_m, parcel.yaw_rad),
        (parcel.goal.x_m, parcel.goal.y_m, parcel.goal.yaw_rad),
        parcel.length_m,
        parcel.width_m,
    )
    places = None if fault else {cell: other}
    finished = run_cells(scenario, [box], LIMIT_S, places, still_after_s=start_s + 0.5)
    return Case(outcome(finished), cell in finished.suspected)


def outcome(finished: Run) -> str:
    """The outcome of a run, in a word."""
    if finished.arrived():
        return "arrived"
    if not finished.tipped and finished.stands() and not finished.claims_arrival():
        return "stood"
    return "failed"


def run_kind(kind: str, seeds: range) -> dict[str, Any]:
    """A row: the share of cases that did not fail."""
    ended: dict[str, list[int]] = {"arrived": [], "stood": [], "failed": []}
    named = 0
    for seed in seeds:
        one = case(kind, seed)
        ended[one.ended].append(seed)
        named += one.named
    cases = len(seeds)
    well = cases - len(ended["failed"])
    return {
        "name": f"{kind}: arrived or stood",
        "ours": 100 * well / cases,
        "peer": None,
        "ratio": None,
        "unit": "%",
        "bound": 100 * at_least(well, cases),
        "cases": cases,
        "arrived": len(ended["arrived"]),
        "stood": len(ended["stood"]),
        "failed": " ".join(map(str, ended["failed"])) or None,
        "named": named,
    }


def run() -> list[dict[str, Any]]:
    """A row for each kind of fault."""
    cases = int(os.environ.get("MDMS_CASES", "5"))
    first = int(os.environ.get("MDMS_SEED", "1"))
    kinds = [kind for kind in os.environ.get("MDMS_KINDS", "").split(",") if kind] or [*FAULTS]
    print(
        f"MDMS_CASES={cases} MDMS_SEED={first} python -m tests.benchmarks broken_cells: seeds "
        f"{first} to {first + cases - 1}; bounds one-sided, {CONFIDENCE:.0%}",
        flush=True,
    )
    table = []
    for kind in kinds:
        table.append(run_kind(kind, range(first, first + cases)))
        print(f"  {table[-1]}", flush=True)
    return table
