"""Parcels an hour of `sort54`: 9 x 6 cells on three buses sort a stream to three exits.

One row on the whole system, firmware and buses, and rows on ideal wheels with beliefs that are
true, where only plans and motion count. The bound is kinematic: a parcel at rest clears 0.30 m
before the next is set down, at 1.1 m/s2, which 0.37 of friction gives. A person singulates 850 to
900 an hour. `MDMS_SECONDS` is how long each run lasts (default 60; the scenario has 600),
`MDMS_CASES` the number of seeds on ideal wheels (default 3), `MDMS_SEED` the first (default 1).
"""

import os
from math import sqrt
from typing import Any

from tests.host.programs.rolling import Rolling

from mdms_array.figures import stream_figures
from mdms_array.simulation import run_scenario
from mdms_array.source import open_program
from mdms_model.run.record import is_wrong
from mdms_model.scenario.scenario import Scenario

CLEARED_M, ACCELERATION_M_S2 = 0.30, 1.1
BOUND_PER_HOUR = 3600.0 / sqrt(2 * CLEARED_M / ACCELERATION_M_S2)
BY_HAND_PER_HOUR = 875.0


def run() -> list[dict[str, Any]]:
    """Rows for the table of benchmarks; the peer is a person."""
    seconds = float(os.environ.get("MDMS_SECONDS", "60"))
    first, cases = int(os.environ.get("MDMS_SEED", "1")), int(os.environ.get("MDMS_CASES", "3"))
    rows = [ideal(seconds, seed) for seed in range(first, first + cases)]
    return [firmware(seconds, first), *rows]


def firmware(seconds: float, seed: int) -> dict[str, Any]:
    """The whole system."""
    scenario, _ = open_program("sort54", [f"run.duration_s={seconds}", f"run.seed={seed}"])
    finished = run_scenario(scenario)
    figures = stream_figures(scenario, finished.record)
    counts = figures["left"], figures["wrong"], figures["touches"]
    return row(
        f"firmware, {seconds:g} s, seed {seed}", scenario, figures["parcels_per_hour"], counts
    )


def ideal(seconds: float, seed: int) -> dict[str, Any]:
    """Plans and motion alone."""
    table = Rolling("sort54", f"run.seed={seed}")
    table.run(seconds)
    left = [event for event in table.world.events if event.kind == "exit"]
    per_hour = 3600.0 * len(left) / (seconds - table.world.scenario.stream[0].start_s)
    counts = len(left), sum(map(is_wrong, left)), len(table.events("touch"))
    return row(f"ideal, {seconds:g} s, seed {seed}", table.world.scenario, per_hour, counts)


def row(
    name: str, scenario: Scenario, per_hour: float, counts: tuple[int, int, int]
) -> dict[str, Any]:
    array = scenario.array
    area_m2 = array.columns * array.rows * array.pitch_m**2
    left, wrong, touches = counts
    return {
        "name": name,
        "ours": per_hour,
        "peer": BY_HAND_PER_HOUR,
        "ratio": per_hour / BY_HAND_PER_HOUR,
        "unit": "parcels/h",
        "per_m2": per_hour / area_m2,
        "share_of_bound": per_hour / BOUND_PER_HOUR,
        "parcels": left,
        "wrong_exit": wrong,
        "touches": touches,
    }
