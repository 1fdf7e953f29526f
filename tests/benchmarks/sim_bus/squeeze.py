"""How near a squeeze plan comes on cells of a finite size, whose wheels slip or do not.

A triangle that needs three squeezes lies at random on a table of 0.72 m; cells get smaller, and
wheels have the friction of the built-in scenarios, or so much that none slips. `ours` is the share
of poses from which the whole plan ends within 20 degrees of its yaw; `bound` is the lower end of a
one-sided confidence interval of it. `MDMS_CASES` is the number of poses (default 20), `MDMS_SEED`
their seed (default 1).
"""

import os
from dataclasses import replace
from typing import Any

import numpy as np
from tests.benchmarks.cells.neighbours import CONFIDENCE, at_least

from mdms_model.array import build_wheels
from mdms_model.fields import references_m_s
from mdms_model.outline import area_and_moment
from mdms_model.scenario.motion import Part
from mdms_model.scenario.scenario import Array, Cell, Parcel, Run, Scenario, Wheel
from mdms_model.squeeze import plan_squeezes, squeeze_function
from mdms_sim.physics.squeeze_trials import (
    final_error_rad,
    random_poses,
    share_within,
    step_outcomes,
    try_squeezes,
)

TABLE_M = 0.72
PITCHES_M = (0.12, 0.06, 0.03, 0.015)
FRICTIONS = (0.3, 100.0)
SPEED_M_S = 0.1
LIMIT_S = 60.0
CORNERS_M = np.array([(-0.20, -0.18), (0.20, -0.18), (0.02, 0.18)])
WHEELS = (Wheel(0.0), Wheel(np.pi / 2))


def triangle() -> Parcel:
    """A uniform plate."""
    area_m2, moment_m3 = area_and_moment(CORNERS_M)
    x_m, y_m = (moment_m3 / area_m2).tolist()
    return Parcel(
        "triangle",
        mass_kg=2.0,
        length_m=0.40,
        width_m=0.36,
        shape="polygon",
        corners_m=tuple((x, y) for x, y in CORNERS_M.tolist()),
        centre_of_mass_m=(x_m, y_m),
    )


def row(pitch_m: float, friction: float, cases: int, seed: int) -> dict[str, Any]:
    """The plan on one kind of cells."""
    cells, part = round(TABLE_M / pitch_m), triangle()
    scenario = Scenario(
        "squeeze",
        Array(cells, cells, pitch_m),
        Cell(wheel=WHEELS, friction=friction),
        (part,),
        run=Run(fidelity="ideal", step_s=0.004),
    )
    plan, wheels = plan_squeezes(squeeze_function(CORNERS_M)), build_wheels(scenario)
    field = Part("squeeze", speed_m_s=SPEED_M_S)
    fields = [
        references_m_s(replace(field, heading_rad=step.heading_rad), wheels) for step in plan.steps
    ]
    poses = random_poses(scenario, part, cases, seed)
    trials = try_squeezes(scenario, part, fields, poses, LIMIT_S)
    error_rad = final_error_rad(plan, trials)
    within = {bound: share_within(error_rad, np.radians(bound)) for bound in (5, 10, 20)}
    near = round(within[20] * len(poses))
    steps = [share_within(each.error_rad, np.radians(10)) for each in step_outcomes(plan, trials)]
    return {
        "name": f"cells of {1000 * pitch_m:g} mm, friction {friction:g}: within 20 degrees",
        "ours": 100 * within[20],
        "peer": None,
        "ratio": None,
        "unit": "%",
        "bound": 100 * at_least(near, len(poses)),
        "poses": len(poses),
        "within_10": 100 * within[10],
        "within_5": 100 * within[5],
        "rested": 100 * float(trials.rests.mean()),
    } | {f"step_{n}_within_10": 100 * share for n, share in enumerate(steps, start=1)}


def run() -> list[dict[str, Any]]:
    """A row for each size of cells and each friction."""
    cases = int(os.environ.get("MDMS_CASES", "20"))
    seed = int(os.environ.get("MDMS_SEED", "1"))
    print(
        f"MDMS_CASES={cases} MDMS_SEED={seed} python -m tests.benchmarks squeeze: "
        f"bounds at {CONFIDENCE:.0%}"
    )
    return [row(pitch_m, friction, cases, seed) for pitch_m in PITCHES_M for friction in FRICTIONS]
