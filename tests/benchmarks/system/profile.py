"""Where the time of a run goes: CPU time and Python calls of a simulated second, by part.

`python -m tests.benchmarks profile [--scenario NAME ...] [--top N]`. The first rows of a scenario
are measured without a profiler. A share is the part of cProfile's time, which weighs short calls
too much. `--top N` lists the N functions with most of the time. Two commits are compared on one
machine at the same time, by the least of several runs.
"""

import cProfile
import pstats
import time
from argparse import ArgumentParser
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

from mdms_array.simulation import run_scenario
from mdms_array.source import open_source
from mdms_model.scenario.scenario import Scenario

Row = dict[str, Any]

SCENARIOS = ("array18", "neighbours", "passing2", "sort54", "swap2")
#: Scenarios that go on for long are cut here [s].
LONGEST_S = 12.0
#: A first run loads the compiled code [s].
WARM_UP_S = 0.5
RUNS = 3
#: Parts of the system by a piece of the path of their files; the first that fits counts.
PARTS = (
    ("neighbour layer", ("mdms_cell/perception", "mdms_cell/rights", "mdms_cell/motion")),
    ("neighbour layer", ("neighbour_layer.py", "mdms_protocol/neighbours", "mailboxes.py")),
    ("CANopen of cells", ("mdms_cell/",)),
    ("bus and kernel", ("mdms_sim/bus/", "kernel.py", "nodes/gateway.py")),
    ("cells' banks", ("mdms_sim/nodes/",)),
    ("referee", ("mdms_sim/referee/",)),
    ("physics", ("mdms_sim/physics/",)),
    ("simulation", ("mdms_sim/", "mdms_model/run/")),
    ("host", ("mdms_host/", "mdms_array/", "mdms_model/", "mdms_protocol/")),
    ("numpy", ("numpy/", "numpy.")),
)


def run(options: list[str] | None = None) -> list[Row]:
    """Profile each scenario."""
    parser = ArgumentParser("python -m tests.benchmarks profile")
    parser.add_argument("--top", type=int, default=0)
    parser.add_argument("--scenario", action="append", dest="scenarios")
    chosen = parser.parse_args(options or [])
    return [row for name in chosen.scenarios or SCENARIOS for row in profiled(name, chosen.top)]


def profiled(name: str, top: int) -> list[Row]:
    """The rows of one scenario."""
    scenario, _ = open_source(name, None)
    scenario = lasting(scenario, min(scenario.run.duration_s, LONGEST_S))
    run_scenario(lasting(scenario, WARM_UP_S))
    cpu_s = []
    for _ in range(RUNS):
        began_s = time.process_time()
        lasted_s = float(run_scenario(scenario).figures["duration_s"])
        cpu_s.append(time.process_time() - began_s)
    profile = cProfile.Profile()
    profile.runcall(run_scenario, scenario)
    stats: Any = pstats.Stats(profile)
    functions = {at: (calls, own_s) for at, (_, calls, own_s, _, _) in stats.stats.items()}
    total_s = sum(own_s for _, own_s in functions.values())
    shares: Counter[str] = Counter()
    for at, (_, own_s) in functions.items():
        shares[part_of(at[0], at[2])] += own_s / total_s
    rows: list[Row] = [
        {"name": f"{name}: CPU time of a second", "ours": min(cpu_s) / lasted_s, "unit": "s"},
        {"name": f"{name}: times real time", "ours": lasted_s / min(cpu_s), "unit": "x"},
        {
            "name": f"{name}: calls of a second",
            "ours": sum(calls for calls, _ in functions.values()) / lasted_s,
            "unit": "calls",
        },
    ]
    for part, share in shares.most_common():
        rows.append({"name": f"{name}: {part}", "ours": 100 * share, "unit": "%"})
    longest = sorted(functions.items(), key=lambda each: -each[1][1])[:top]
    for (path, line, function), (calls, own_s) in longest:
        where = f"{Path(path).name}:{line} {function}"
        rows.append(
            {"name": where[:52], "ours": 100 * own_s / total_s, "unit": "%", "calls": calls}
        )
    return rows


def lasting(scenario: Scenario, duration_s: float) -> Scenario:
    """The same scenario with another end."""
    return replace(scenario, run=replace(scenario.run, duration_s=duration_s))


def part_of(path: str, function: str) -> str:
    """The part of the system that a function belongs to."""
    for part, pieces in PARTS:
        if any(piece in path or piece in function for piece in pieces):
            return part
    return "Python itself"
