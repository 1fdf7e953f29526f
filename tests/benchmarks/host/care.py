"""Trouble of every kind on the way: how many boxes arrive, and whether the host says so truly.

Boxes of three sizes get seeded start and goal poses on 6 x 3 cells, with motors and friction that
differ by up to 30 %; the instant of the trouble, and its cell, are drawn by seed, while the box is
on its way. A box has arrived that the host says is there, and that rests within 3 mm and 1 degree
of its goal in truth. The referee judges every case: `untrue` are arrivals that are said 5 mm or 2
degrees off, `broken` its other rules. `bound` is the lower end of a one-sided 95 % confidence
interval of the share that arrives (Clopper and Pearson), `untrue_bound` the upper end of that of
the cases with an untrue arrival. `late_s` is the longest from when a box is there to stay, as the
referee counts, to the host's word. `moved_mm_s` is the greatest speed of a box from 0.5 s of a hold
on. `MDMS_CASES` is the number of cases of each kind (default 20), `MDMS_SEED` the first seed
(default 1), `MDMS_KINDS` names the kinds, parted by semicolons, and `MDMS_CONTROL` who steers
(default host); a case takes 3 s where the host steers, 9 s where the cells do.
"""

import os
from contextlib import closing
from dataclasses import dataclass
from math import degrees, hypot, pi, radians, remainder
from random import Random
from typing import Any

from tests.benchmarks.cells.neighbours import CELLS, CONFIDENCE, at_least, scenario_of

from mdms_array.host import coordinator_of
from mdms_array.simulation import host_report_of
from mdms_host.coordination.run_state import HELD
from mdms_model.scenario.scenario import Scenario
from mdms_sim.nodes.python_bank import PythonBank
from mdms_sim.referee.claims import TRUE_M, TRUE_RAD
from mdms_sim.simulation import Simulation

LIMIT_S = 20.0
WITHIN_M, WITHIN_RAD = 0.003, radians(1.0)
#: A box begins to move at about 0.5 s, and needs about one.
FIRST_S, LAST_S = 0.6, 1.2
REST_S, STEP_S = 0.5, 0.01
EAST = "cells=[4, 5, 6, 10, 11, 12, 16, 17, 18]"
GO_ON = "run.on_lost_cell='go_on'"
NOTHING = "kind='loss', probability=0.0"
#: A hexagon as a drawing has it, in whole millimetres: six poses look nearly alike.
HEXAGON = (
    "parcel.0.shape='polygon'",
    "parcel.0.length_m=0.34",
    "parcel.0.width_m=0.294",
    "parcel.0.corners_m=[[0.17, 0.0], [0.085, 0.147], [-0.085, 0.147], [-0.17, 0.0], "
    "[-0.085, -0.147], [0.085, -0.147]]",
)


def size(length_m: float, width_m: float) -> tuple[str, ...]:
    """The settings of a box of this size."""
    return (f"parcel.0.length_m={length_m}", f"parcel.0.width_m={width_m}")


def told(length_m: float, width_m: float) -> tuple[str, ...]:
    """The settings of the host that takes the box to be so large, within some 8 mm."""
    return (
        f"belief.box.length_m={length_m}",
        f"belief.box.width_m={width_m}",
        "belief.box.size_spread_m=0.008",
    )


#: By name: the fault, with the numbers of one or two cells to fill in, and what else is set.
KINDS: dict[str, tuple[str, tuple[str, ...]]] = {
    "no trouble": (NOTHING, ()),
    "1 % of presence bits wrong": (NOTHING, ("cell.sensor_noise=0.01",)),
    "2 % of frames lost": ("kind='loss', probability=0.02", ()),
    "10 % lost for 1 s": ("kind='loss', probability=0.1, duration_s=1.0", ()),
    "30 % lost for 2 s": ("kind='loss', probability=0.3, duration_s=2.0", ()),
    "30 % lost for 2 s, go_on": ("kind='loss', probability=0.3, duration_s=2.0", (GO_ON,)),
    "bus cut for 20 ms": (f"kind='cut', {EAST}, duration_s=0.02", ()),
    "bus cut for 0.2 s": (f"kind='cut', {EAST}, duration_s=0.2", ()),
    "bus cut for 2 s": (f"kind='cut', {EAST}, duration_s=2.0", ()),
    "host cut off for 0.15 s": ("kind='host', duration_s=0.15", ()),
    "host cut off for 0.5 s": ("kind='host', duration_s=0.5", ()),
    "cell reboots": ("kind='off', cells=[{cell}], duration_s=0.05", ()),
    "cell reboots, go_on": ("kind='off', cells=[{cell}], duration_s=0.05", (GO_ON,)),
    "cell bus-off": ("kind='corruption', cells=[{cell}], duration_s=0.05", ()),
    "cell hangs, watchdog": ("kind='hang', cells=[{cell}], duration_s=0.27", ()),
    "cell hangs, no watchdog, go_on": ("kind='hang', cells=[{cell}]", (GO_ON,)),
    "cell off, go_on": ("kind='off', cells=[{cell}]", (GO_ON,)),
    "0.36 x 0.30 m, cell off, go_on": ("kind='off', cells=[{cell}]", (GO_ON, *size(0.36, 0.30))),
    "0.36 x 0.30 m, two cells off, go_on": (
        "kind='off', cells=[{cell}, {other}]",
        (GO_ON, *size(0.36, 0.30)),
    ),
    "0.26 x 0.26 m, cell off, go_on": ("kind='off', cells=[{cell}]", (GO_ON, *size(0.26, 0.26))),
    "told 15 mm too large": (NOTHING, (*size(0.36, 0.30), *told(0.375, 0.315))),
    "told 15 mm too small": (NOTHING, (*size(0.36, 0.30), *told(0.345, 0.285))),
    "mass told four times too large": (NOTHING, ("parcel.0.mass_kg=1", "belief.box.mass_kg=4")),
    "hexagon": (NOTHING, HEXAGON),
    "0.20 x 0.20 m": (NOTHING, size(0.20, 0.20)),
}
#: Cells refuse such a parcel by its name.
HOST_ONLY = {"told 15 mm too large", "told 15 mm too small", "hexagon", "0.20 x 0.20 m"}
#: Some of these boxes tip (`docs/motion.md`), so they run by name alone.
BY_NAME = {"0.20 x 0.20 m"}


@dataclass(slots=True)
class Case:
    """How a case has ended, and the violations that the referee has noted."""

    arrived: bool = False
    untrue: str = ""
    broken: str = ""
    pauses: int = 0
    moved_m_s: float = 0.0
    late_s: float = 0.0
    reason: str = ""


def struck(kind: str, seed: int, control: str = "host") -> Scenario:
    """The scenario of a seed with its trouble."""
    random = Random(f"{kind} {seed}")
    fault, more = KINDS[kind]
    cell, start_s = random.randint(1, CELLS), random.uniform(FIRST_S, LAST_S)
    other = random.choice([each for each in range(1, CELLS + 1) if each != cell])
    fault = fault.format(cell=cell, other=other)
    return scenario_of(
        seed,
        f"motion.control='{control}'",
        f"run.duration_s={LIMIT_S}",
        f"fault=[{{{fault}, start_s={start_s:.3f}}}]",
        *more,
    )


def case(scenario: Scenario) -> Case:
    """Run until the box rests at its goal, the run has ended, or the time is over."""
    coordinator, result = coordinator_of(scenario), Case()
    fault = scenario.fault[0]
    over_s = fault.start_s + (fault.duration_s or 0.0)
    held_s = finished_s = there_s = 0.0
    with closing(PythonBank(range(1, CELLS + 1))) as bank:
        simulation = Simulation(
            scenario,
            bank,
            [coordinator],
            host_report=lambda: host_report_of(coordinator),
            recording=None,
        )
        for step in range(1, round(LIMIT_S / STEP_S) + 1):
            now_s = STEP_S * step
            simulation.run_until(now_s)
            vx_m_s, vy_m_s, _ = simulation.world.twist[0]
            held_s = held_s + STEP_S if coordinator.phase in HELD else 0.0
            if held_s > 0.5:
                result.moved_m_s = max(result.moved_m_s, hypot(vx_m_s, vy_m_s))
            off_m, off_rad = off_goal(simulation)
            if off_m > TRUE_M or abs(off_rad) > TRUE_RAD:
                there_s = now_s
            if coordinator.finished and not finished_s:
                result.late_s = max(result.late_s, now_s - there_s)
            finished = coordinator.finished and now_s > over_s
            finished_s = finished_s + STEP_S if finished else 0.0
            if finished_s > REST_S or coordinator.stopped or simulation.tipped:
                break
        simulation.referee.finish()
    within = off_m <= WITHIN_M and abs(off_rad) <= WITHIN_RAD
    result.arrived = finished_s > 0.0 and within and not simulation.tipped
    result.pauses = coordinator.pauses
    away = f"{1e3 * off_m:.1f} mm and {degrees(off_rad):.1f} degrees away"
    why = coordinator.fault or coordinator.lost or coordinator.stuck
    if why is None and coordinator.troubles:
        why = coordinator.troubles[-1][1]
    result.reason = away if why is None else f"{away} ({why})"
    for violation in simulation.referee.violations:
        if violation.rule == "true":
            result.untrue = violation.text
        else:
            result.broken = f"{violation.rule}: {violation.text}"
    return result


def off_goal(simulation: Simulation) -> tuple[float, float]:
    """How far the box is from its goal in truth: distance [m], turn [rad]."""
    goal = simulation.world.scenario.parcel[0].goal
    assert goal is not None
    x_m, y_m, yaw_rad = simulation.world.pose[0].tolist()
    return hypot(x_m - goal.x_m, y_m - goal.y_m), remainder(yaw_rad - goal.yaw_rad, pi)


def row_of(kind: str, cases: dict[int, Case]) -> dict[str, Any]:
    """How many boxes of a kind arrive; their untrue reports and broken rules, by seed."""
    well, count = sum(one.arrived for one in cases.values()), len(cases)
    untrue = {seed: one.untrue for seed, one in cases.items() if one.untrue}
    broken = {seed: one.broken for seed, one in cases.items() if one.broken}
    return {
        "name": f"{kind}: arrived",
        "ours": well,
        "peer": None,
        "ratio": None,
        "unit": f"of {count}",
        "bound": 100 * at_least(well, count),
        "untrue": len(untrue),
        "untrue_bound": 100 * (1 - at_least(count - len(untrue), count)),
        "broken": len(broken),
        "pauses": sum(one.pauses for one in cases.values()),
        "late_s": max(one.late_s for one in cases.values()),
        "moved_mm_s": 1e3 * max(one.moved_m_s for one in cases.values()),
        "missed": by_seed({seed: one.reason for seed, one in cases.items() if not one.arrived}),
        "why_untrue": by_seed(untrue),
        "why_broken": by_seed(broken),
        "failed": len(untrue) + len(broken),
    }


def by_seed(texts: dict[int, str]) -> str | None:
    """The text of each case, in one line."""
    return "; ".join(f"{seed}: {text}" for seed, text in texts.items()) or None


def run() -> list[dict[str, Any]]:
    """A row for each kind of trouble."""
    cases = int(os.environ.get("MDMS_CASES", "20"))
    first = int(os.environ.get("MDMS_SEED", "1"))
    control = os.environ.get("MDMS_CONTROL", "host")
    kinds = [kind for kind in os.environ.get("MDMS_KINDS", "").split(";") if kind] or [
        kind
        for kind in KINDS
        if kind not in BY_NAME and (control == "host" or kind not in HOST_ONLY)
    ]
    print(
        f"MDMS_CASES={cases} MDMS_SEED={first} MDMS_CONTROL={control} python -m tests.benchmarks "
        f"care: seeds {first} to {first + cases - 1}; bounds one-sided, {CONFIDENCE:.0%}",
        flush=True,
    )
    table = []
    for kind in kinds:
        seeds = range(first, first + cases)
        table.append(row_of(kind, {seed: case(struck(kind, seed, control)) for seed in seeds}))
        print(f"  {table[-1]}", flush=True)
    return table
