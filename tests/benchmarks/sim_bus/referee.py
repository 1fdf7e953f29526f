"""The cost of the referee: runs in closed loop with it and without, side by side.

`ours` is how much longer a run takes with it, as a share; its share of the whole is to be a tenth
at most. Runs take turns, the processor's time counts, and the shortest of each kind is compared.
"""

import time
from contextlib import closing
from typing import Any

from mdms_array.host import coordinator_of
from mdms_model.scenario.file import load_scenario
from mdms_sim.simulation import Simulation, addresses_of, open_bank

SCENARIOS = ("array18", "neighbours", "array54")
WARM_UP_S = 1.0
DURATION_S = 2.0
ROUNDS = 4


def run() -> list[dict[str, Any]]:
    """The cost of the referee, by scenario."""
    return [cost(name) for name in SCENARIOS]


def cost(name: str) -> dict[str, Any]:
    """One line of the table."""
    times_s = [(lap(name, judged=True), lap(name, judged=False)) for _ in range(ROUNDS)]
    judged_s, alone_s = (min(column) for column in zip(*times_s, strict=True))
    return {
        "name": f"{name} with the referee beside without",
        "ours": judged_s / alone_s - 1.0,
        "peer": None,
        "ratio": judged_s / alone_s,
        "unit": "of the run",
        "ms_a_simulated_second": 1e3 * (judged_s - alone_s) / DURATION_S,
    }


def lap(name: str, *, judged: bool) -> float:
    """Time of the processor for a run after its warm-up [s]."""
    scenario = load_scenario(name, [])
    with closing(open_bank("cpython", addresses_of(scenario).node_ids)) as bank:
        simulation = Simulation(scenario, bank, [coordinator_of(scenario)], judged=judged)
        simulation.run_until(WARM_UP_S)
        start_s = time.process_time()
        simulation.run_until(WARM_UP_S + DURATION_S)
        return time.process_time() - start_s
