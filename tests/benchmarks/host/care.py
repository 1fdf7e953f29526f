"""Trouble that passes, and a cell that is dead: how many boxes arrive all the same.

Boxes of three sizes get seeded start and goal poses on 6 x 3 cells, with motors and friction that
differ by up to 30 %; the instant of the trouble, and its cell, are drawn by seed, while the box is
on its way. A box has arrived within 5 mm and 2 degrees of its goal at rest; `bound` is the lower
end of a one-sided 95 % confidence interval of that share (Clopper and Pearson). `moved_mm_s` is the
greatest speed of a box from 0.5 s of a hold on, in all cases. `MDMS_CASES` is the number of cases
of each kind (default 20), `MDMS_SEED` the first seed (default 1), `MDMS_KINDS` names the kinds,
parted by semicolons, and `MDMS_CONTROL` who steers (default host); a case takes some 2 s.
"""

import os
from contextlib import closing
from dataclasses import dataclass
from math import hypot, pi
from random import Random
from typing import Any

from tests.benchmarks.cells.neighbours import CELLS, CONFIDENCE, at_least, scenario_of

from mdms_array.host import coordinator_of
from mdms_host.coordination.phase import HELD
from mdms_model.scenario.scenario import Scenario
from mdms_sim.nodes.python_bank import PythonBank
from mdms_sim.simulation import Simulation

LIMIT_S = 20.0
WITHIN_M, WITHIN_RAD = 0.005, 2.0 * pi / 180
#: A box begins to move at about 0.5 s, and needs about one.
FIRST_S, LAST_S = 0.6, 1.2
REST_S = 0.5
EAST = "cells=[4, 5, 6, 10, 11, 12, 16, 17, 18]"
GO_ON = "run.on_lost_cell='go_on'"
#: By name: the fault, with the number of a cell to fill in, and what else is set.
KINDS: dict[str, tuple[str, tuple[str, ...]]] = {
    "no trouble": ("kind='loss', probability=0.0", ()),
    "2 % of frames lost": ("kind='loss', probability=0.02", ()),
    "10 % lost for 1 s": ("kind='loss', probability=0.1, duration_s=1.0", ()),
    "30 % lost for 2 s": ("kind='loss', probability=0.3, duration_s=2.0", ()),
    "partition of 0.2 s": (f"kind='cut', {EAST}, duration_s=0.2", ()),
    "partition of 2 s": (f"kind='cut', {EAST}, duration_s=2.0", ()),
    "host cut off for 0.5 s": ("kind='host', duration_s=0.5", ()),
    "cell reboots": ("kind='off', cells=[{cell}], duration_s=0.05", ()),
    "cell hangs, watchdog": ("kind='hang', cells=[{cell}], duration_s=0.27", ()),
    "cell bus-off": ("kind='corruption', cells=[{cell}], duration_s=0.05", ()),
    "cell dies, go_on": ("kind='off', cells=[{cell}]", (GO_ON,)),
    "cell reboots, go_on": ("kind='off', cells=[{cell}], duration_s=0.05", (GO_ON,)),
    "30 % lost for 2 s, go_on": ("kind='loss', probability=0.3, duration_s=2.0", (GO_ON,)),
}


@dataclass(frozen=True, slots=True)
class Case:
    """Whether a box has arrived, how often it was held, how fast it was while held, and why not."""

    arrived: bool
    pauses: int
    moved_m_s: float
    reason: str


def struck(kind: str, seed: int, control: str = "host") -> Scenario:
    """The scenario of a seed with its trouble."""
    random = Random(f"{kind} {seed}")
    fault, more = KINDS[kind]
    fault = fault.format(cell=random.randint(1, CELLS))
    start_s = random.uniform(FIRST_S, LAST_S)
    return scenario_of(
        seed,
        f"motion.control='{control}'",
        f"run.duration_s={LIMIT_S}",
        f"fault=[{{{fault}, start_s={start_s:.3f}}}]",
        *more,
    )


def case(scenario: Scenario) -> Case:
    """Run until the box rests at its goal, the run has ended, or the time is over."""
    coordinator = coordinator_of(scenario)
    goal, fault = scenario.parcel[0].goal, scenario.fault[0]
    assert goal is not None
    over_s = fault.start_s + (fault.duration_s or 0.0)
    moved_m_s = held_s = finished_s = 0.0
    with closing(PythonBank(range(1, CELLS + 1))) as bank:
        simulation = Simulation(scenario, bank, [coordinator], recorded=False)
        for step in range(1, round(LIMIT_S / 0.01) + 1):
            simulation.run_until(0.01 * step)
            vx_m_s, vy_m_s, _ = simulation.world.twist[0]
            held_s = held_s + 0.01 if coordinator.phase in HELD else 0.0
            if held_s > 0.5:
                moved_m_s = max(moved_m_s, hypot(vx_m_s, vy_m_s))
            arrived = coordinator.finished and 0.01 * step > over_s
            finished_s = finished_s + 0.01 if arrived else 0.0
            if finished_s > REST_S or coordinator.stopped or simulation.tipped:
                break
        x_m, y_m, yaw_rad = simulation.world.pose[0]
    turn_rad = (yaw_rad - goal.yaw_rad + pi) % (2 * pi) - pi
    off_m = hypot(x_m - goal.x_m, y_m - goal.y_m)
    arrived = off_m <= WITHIN_M and abs(turn_rad) <= WITHIN_RAD and not simulation.tipped
    away = f"{1e3 * off_m:.1f} mm and {180 / pi * turn_rad:.1f} degrees away"
    reason = coordinator.fault or coordinator.lost or coordinator.stuck or away
    return Case(arrived, coordinator.pauses, moved_m_s, reason)


def run_kind(kind: str, seeds: range, control: str) -> dict[str, Any]:
    """A row: the share of boxes that arrive."""
    cases = {seed: case(struck(kind, seed, control)) for seed in seeds}
    missed = {seed: one.reason for seed, one in cases.items() if not one.arrived}
    well = len(cases) - len(missed)
    return {
        "name": f"{kind}: arrived",
        "ours": 100 * well / len(cases),
        "peer": None,
        "ratio": None,
        "unit": "%",
        "bound": 100 * at_least(well, len(cases)),
        "cases": len(cases),
        "pauses": sum(one.pauses for one in cases.values()),
        "moved_mm_s": 1e3 * max(one.moved_m_s for one in cases.values()),
        "missed": "; ".join(f"{seed}: {reason}" for seed, reason in missed.items()) or None,
    }


def run() -> list[dict[str, Any]]:
    """A row for each kind of trouble."""
    cases = int(os.environ.get("MDMS_CASES", "20"))
    first = int(os.environ.get("MDMS_SEED", "1"))
    control = os.environ.get("MDMS_CONTROL", "host")
    kinds = [kind for kind in os.environ.get("MDMS_KINDS", "").split(";") if kind] or [*KINDS]
    print(
        f"MDMS_CASES={cases} MDMS_SEED={first} MDMS_CONTROL={control} python -m tests.benchmarks "
        f"care: seeds {first} to {first + cases - 1}; bounds one-sided, {CONFIDENCE:.0%}",
        flush=True,
    )
    table = []
    for kind in kinds:
        table.append(run_kind(kind, range(first, first + cases), control))
        print(f"  {table[-1]}", flush=True)
    return table
