"""`swap2` with either loop: the host sets every wheel, or the cells steer and get legs as goals.

Firmware and buses of 54 cells; `MDMS_CASES` is the number of seeds (default 3), `MDMS_SEED` the
first (default 1). Cells take a share of friction that needs no trajectory, so that they are slower.
"""

import os
from typing import Any

import numpy as np

from mdms_host.cli.simulation.compose import run_scenario
from mdms_host.cli.simulation.figures import figures_of
from mdms_model.scenario.file import load_scenario

LIMIT_S = 25.0
LOOPS = {
    "host": (),
    "cells": ("motion.control='cells'", "array.forwarded=[1, 2, 3, 4]"),
}


def run() -> list[dict[str, Any]]:
    """A row for each loop."""
    first, cases = int(os.environ.get("MDMS_SEED", "1")), int(os.environ.get("MDMS_CASES", "3"))
    return [row(loop, range(first, first + cases)) for loop in LOOPS]


def row(loop: str, seeds: range) -> dict[str, Any]:
    """How many seeds end with both at their places, and after how long."""
    durations_s, errors_m, arrived, touches = [], [0.0], 0, 0
    for seed in seeds:
        overrides = [*LOOPS[loop], f"run.seed={seed}", f"run.duration_s={LIMIT_S}"]
        scenario = load_scenario("swap2", overrides)
        finished = run_scenario(scenario)
        goals = figures_of(scenario, finished)["goals"]
        touches += sum(event.kind == "touch" for event in finished.record.events)
        if finished.fault is None and not finished.unfinished and all(g["reached"] for g in goals):
            arrived += 1
            durations_s.append(float(finished.record.time_s[-1]))
            errors_m += [goal["position_error_m"] for goal in goals]
    return {
        "name": f"swap2 by {loop}, simulated time to its end",
        "ours": float(np.median(durations_s)) if durations_s else None,
        "peer": None,
        "ratio": None,
        "unit": "s",
        "arrived": arrived,
        "of": len(seeds),
        "touches": touches,
        "worst_mm": 1e3 * max(errors_m),
    }
