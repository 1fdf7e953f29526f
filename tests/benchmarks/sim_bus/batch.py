"""Many tables at once: a batch beside worlds one by one, two threads beside one, and MuJoCo.

Each table is the 18 cells and the box of `plane`, under the references that make it slip, in steps
of 1 ms. MuJoCo's `rollout` takes the same scene on as many threads. Ours and its peer take turns in
one run, and the shortest of some trials counts.
"""

import os
from functools import partial
from typing import Any

import numpy as np
from tests.benchmarks.sim_bus.plane import FIELDS, STEP_S, best_of, mujoco_scene, references

from mdms_model.arrays import Floats
from mdms_model.motor import drive_of
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import Scenario
from mdms_sim.physics.plane.batch import Batch
from mdms_sim.physics.plane.world import World

Row = dict[str, Any]

TABLES = (1, 16, 256, 4096)
#: Steps of a table in one call: a control period.
PERIOD = 10
#: A trial is one call, so short that others who use the processor leave some trials alone.
TRIALS = 60
#: After so many trials all tables begin anew: later they would have lost their boxes.
ANEW = 20
THREADS = min(2, os.cpu_count() or 1)


def run() -> list[Row]:
    """All rows of the table."""
    scenario = load_scenario("array18", ["cell.motor_spread=0", "cell.friction_spread=0"])
    reference = references(scenario, FIELDS["slipping"][0])
    rows = []
    for tables in TABLES:
        rates = rates_of(scenario, reference, tables)
        rows += [
            row(f"{tables} tables, 1 thread, beside worlds one by one", rates[1], rates[0]),
            row(f"{tables} tables, {THREADS} threads, beside 1", rates[THREADS], rates[1]),
            row(
                f"{tables} tables, {THREADS} threads, beside MuJoCo's rollout",
                rates[THREADS],
                mujoco_rate(scenario, reference, tables),
            ),
        ]
    return rows


def row(name: str, ours: float, peer: float) -> Row:
    """A row of steps per second."""
    return {"name": name, "ours": ours, "peer": peer, "ratio": ours / peer, "unit": "steps/s"}


def rates_of(scenario: Scenario, reference: Floats, tables: int) -> dict[int, float]:
    """Steps of tables per second by threads; 0 has those of worlds one by one."""
    worlds = [World(scenario) for _ in range(min(tables, 16))]
    drive = np.tile(reference, (tables, 1))
    batches = {threads: Batch([scenario] * tables, threads=threads) for threads in {1, THREADS}}
    start = worlds[0].state()

    def one_by_one() -> None:
        for world in worlds:
            for _ in range(PERIOD):
                world.step_ideal(reference, STEP_S)

    best = dict.fromkeys((0, *batches), np.inf)
    for trial in range(TRIALS):
        if trial % ANEW == 0:
            for world in (*worlds, *(each for batch in batches.values() for each in batch.worlds)):
                world.restore(start)
        best[0] = min(best[0], best_of(1, one_by_one) / len(worlds))
        for threads, batch in batches.items():
            together = partial(batch.step_ideal, drive, STEP_S, PERIOD)
            best[threads] = min(best[threads], best_of(1, together) / tables)
    return {threads: PERIOD / best_s for threads, best_s in best.items()}


def mujoco_rate(scenario: Scenario, reference: Floats, tables: int) -> float:
    """Steps of tables per second by MuJoCo, after the box has sunk into its soft supports."""
    import mujoco
    from mujoco.rollout import Rollout

    model = mujoco.MjModel.from_xml_string(mujoco_scene(scenario))
    data = [mujoco.MjData(model) for _ in range(THREADS)]
    for _ in range(500):
        mujoco.mj_step(model, data[0])
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.empty(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data[0], state, kind)
    steps = max(PERIOD, 1_000 // tables)
    drive = drive_of(scenario.cell).droop * reference / scenario.cell.wheel_radius_m
    control = np.tile(drive, (tables, steps, 1))
    states = np.tile(state, (tables, 1))
    with Rollout(nthread=THREADS) as rollout:
        took_s = best_of(
            5 if tables > 1000 else 20, lambda: rollout.rollout(model, data, states, control)
        )
    return steps * tables / took_s
