"""`swap2` with either loop: the host sets every wheel, or the cells steer and get legs as goals.

Firmware and buses of 54 cells; `MDMS_CASES` is the number of seeds (default 3), `MDMS_SEED` the
first (default 1), `MDMS_LOOPS` names the rows (host, cells, alone). Cells take a share of friction
that needs no trajectory, so that they are slower.

In `alone` the cells steer, and the host is killed for good at an instant that is drawn by seed,
while both parcels are on their way. A parcel has arrived within 5 mm of its goal (and 2 degrees,
the box) at rest; `stood` counts the cases in which all are at rest and some elsewhere, `failed`
those in which one still moves, tips or touches. `bound` is the lower end of a one-sided 95 %
confidence interval of the share in which both arrive (Clopper and Pearson).
"""

import os
from math import pi
from random import Random
from typing import Any

import numpy as np
from tests.benchmarks.cells.neighbours import at_least

from mdms_array.simulation import run_scenario
from mdms_model.scenario.file import load_scenario

LIMIT_S = 25.0
#: Both are under way from 1 s on, and at their goals after some 9 s.
FIRST_S, LAST_S, ALONE_S = 1.0, 6.0, 20.0
WITHIN_M, WITHIN_RAD, STILL = 0.005, 2.0 * pi / 180, 5e-3
LOOPS = {
    "host": (),
    "cells": ("motion.control='cells'", "array.forwarded=[1, 2, 3, 4]"),
}


def run() -> list[dict[str, Any]]:
    """A row for each loop."""
    first, cases = int(os.environ.get("MDMS_SEED", "1")), int(os.environ.get("MDMS_CASES", "3"))
    seeds = range(first, first + cases)
    loops = [loop for loop in os.environ.get("MDMS_LOOPS", "").split(",") if loop]
    return [
        alone(seeds) if loop == "alone" else row(loop, seeds) for loop in loops or [*LOOPS, "alone"]
    ]


def row(loop: str, seeds: range) -> dict[str, Any]:
    """How many seeds end with both at their places, and after how long."""
    durations_s, errors_m, arrived, touches = [], [0.0], 0, 0
    for seed in seeds:
        overrides = [*LOOPS[loop], f"run.seed={seed}", f"run.duration_s={LIMIT_S}"]
        scenario = load_scenario("swap2", overrides)
        finished = run_scenario(scenario)
        touches += sum(event.kind == "touch" for event in finished.record.events)
        if finished.status == "reached":
            arrived += 1
            durations_s.append(float(finished.record.time_s[-1]))
            errors_m += [goal["position_error_m"] for goal in finished.figures["goals"]]
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


def alone(seeds: range) -> dict[str, Any]:
    """How many seeds end with both at their places though the host is killed on the way."""
    ended: dict[str, list[int]] = {"arrived": [], "stood": [], "failed": []}
    errors_m = [0.0]
    for seed in seeds:
        gone_s = Random(f"alone {seed}").uniform(FIRST_S, LAST_S)
        overrides = [
            *LOOPS["cells"],
            "motion.go_on=true",
            f"fault=[{{kind='host', start_s={gone_s:.3f}}}]",
            f"run.seed={seed}",
            f"run.duration_s={ALONE_S}",
        ]
        record = run_scenario(load_scenario("swap2", overrides)).record
        starts, ends = record.pose[0], record.pose[-1]
        off_m = np.hypot(*(ends[:, :2] - starts[::-1, :2]).T)
        there = off_m.max() < WITHIN_M and abs(ends[0, 2]) < WITHIN_RAD
        still = np.abs(record.twist[-50:]).max() < STILL
        harmed = any(event.kind in ("touch", "tip") for event in record.events)
        outcome = "failed" if harmed or not still else "arrived" if there else "stood"
        ended[outcome].append(seed)
        errors_m += off_m.tolist() if outcome == "arrived" else []
        print(f"  seed {seed}: host gone at {gone_s:.2f} s, {outcome}", flush=True)
    arrived = len(ended["arrived"])
    return {
        "name": "swap2 by cells, host killed on the way: both arrived",
        "ours": 100 * arrived / len(seeds),
        "peer": None,
        "ratio": None,
        "unit": "%",
        "bound": 100 * at_least(arrived, len(seeds)),
        "of": len(seeds),
        "stood": " ".join(map(str, ended["stood"])) or None,
        "failed": " ".join(map(str, ended["failed"])) or None,
        "worst_mm": 1e3 * max(errors_m),
    }
