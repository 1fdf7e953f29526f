"""Cost of a run that is not simulation, in a process that has run others before; and of workers.

Times are the shortest of some trials. The workers of a sweep take turns with as many processes that
do the same runs without a sweep.
"""

import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import closing
from functools import partial
from typing import Any

import mdms_array as mdms
from mdms_array.host import coordinator_of, references_m_s
from mdms_host.coordination.coordinator import Coordinator
from mdms_host.coordination.run_state import Phase
from mdms_model.scenario.file import load_scenario
from mdms_sim.physics.plane.ideal import run_ideal
from mdms_sim.physics.plane.world import World
from mdms_sim.simulation import Simulation, addresses_of, open_bank

Row = dict[str, Any]

DURATION_S = 2.0
TRIALS = 15
WORKERS, RUNS = 2, 40
SCRIPT = f"""
import mdms_array as mdms
from mdms_model.scenario.file import load_scenario
for replication in range({{first}}, {RUNS}, {WORKERS}):
    changes = [f"run.seed={{{{mdms.run_seed(1, replication)}}}}", "run.duration_s={DURATION_S}"]
    mdms.simulate(load_scenario("array18", changes))
"""


def run() -> list[Row]:
    """All rows of the table."""
    return [*firmware(), ideal(), workers()]


def row(name: str, ours: float, peer: float | None, unit: str = "ms") -> Row:
    """A row; the ratio is that of both."""
    ratio = None if peer is None else ours / peer
    return {"name": name, "ours": ours, "peer": peer, "ratio": ratio, "unit": unit}


def firmware() -> list[Row]:
    """The parts of a warm run of `array18`, in milliseconds."""
    scenario = load_scenario("array18", [f"run.duration_s={DURATION_S}"])
    best = dict.fromkeys(("set-up", "bring-up", "the rest"), float("inf"))
    for _ in range(TRIALS):
        times = [time.perf_counter()]
        coordinator = coordinator_of(scenario)
        with closing(open_bank("cpython", addresses_of(scenario).node_ids)) as bank:
            simulation = Simulation(scenario, bank, [coordinator])
            times.append(time.perf_counter())
            simulation.run_until(DURATION_S, over=partial(is_up, coordinator))
            times.append(time.perf_counter())
            simulation.run_until(DURATION_S)
            times.append(time.perf_counter())
        for name, start, end in zip(best, times, times[1:], strict=False):
            best[name] = min(best[name], 1e3 * (end - start))
    whole = 1e3 * shortest(lambda: mdms.simulate(scenario))
    name = f"warm run of {DURATION_S:g} s, firmware"
    return [row(f"{name}: all", whole, None)] + [
        row(f"{name}: {part}", ms, whole) for part, ms in best.items()
    ]


def is_up(coordinator: Coordinator) -> bool:
    """Whether the cells are up."""
    return coordinator.phase is Phase.RUNNING


def ideal() -> Row:
    """A warm run of the model beside its steps alone."""
    changes = ["run.fidelity=ideal", "motion.field=inward", f"run.duration_s={DURATION_S}"]
    scenario = load_scenario("array18", changes)
    reference = references_m_s(scenario)
    steps = round(DURATION_S / scenario.run.step_s)
    worlds = iter([World(scenario) for _ in range(TRIALS)])
    alone = shortest(
        lambda: run_ideal(next(worlds), reference, scenario.run.step_s, steps, steps // 200)
    )
    whole = shortest(lambda: mdms.simulate(scenario))
    name = f"warm run of {DURATION_S:g} s, ideal, beside its steps"
    return row(name, 1e3 * whole, 1e3 * alone)


def shortest(trial: Callable[[], object]) -> float:
    """The shortest wall time of some trials [s]."""
    times = []
    for _ in range(TRIALS):
        start = time.perf_counter()
        trial()
        times.append(time.perf_counter() - start)
    return min(times)


def workers() -> Row:
    """Runs a second of a sweep's workers, beside processes that do the same runs."""
    rates: dict[str, list[float]] = {"sweep": [], "processes": []}
    for _ in range(3):
        for name, trial in (("sweep", by_sweep), ("processes", by_processes)):
            start = time.perf_counter()
            trial()
            rates[name].append(RUNS / (time.perf_counter() - start))
    name = f"{WORKERS} workers beside {WORKERS} processes"
    return row(name, max(rates["sweep"]), max(rates["processes"]), "runs/s")


def by_sweep() -> None:
    """The runs by a sweep: its processes start, and end."""
    mdms.sweep(
        {"scenario": "array18", "run": {"duration_s": DURATION_S}},
        {"cell.friction": [0.3]},
        seeds=RUNS,
        workers=WORKERS,
    )


def by_processes() -> None:
    """The same runs by processes of their own, each with one thread."""
    scripts = [SCRIPT.format(first=first) for first in range(WORKERS)]
    processes = [subprocess.Popen([sys.executable, "-c", script]) for script in scripts]
    for process in processes:
        if process.wait():
            raise RuntimeError("a process has failed")
