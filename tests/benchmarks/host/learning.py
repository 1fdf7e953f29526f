"""Environments for learning: steps a second with observation, of one table and of many.

A step is a control period of 10 ms of the 18 cells of `array18` under random references. The peer
is the goal that the environments were built for.
"""

import time
from typing import Any

import gymnasium
import numpy as np

import mdms_array.learning  # noqa: F401 - it registers the environments

Row = dict[str, Any]

NAME = "mdms/Parcel-v0"
TABLES = 256
#: Steps a second: one table on one processor, and of all tables together.
GOAL_ONE, GOAL_MANY = 15_000.0, 60_000.0
TRIALS, TRIAL_S = 15, 0.3


def run() -> list[Row]:
    """All rows of the table."""
    rows = [row("one table, ideal", gymnasium.make(NAME), GOAL_ONE)]
    for threads in (1, 2):
        many = gymnasium.make_vec(NAME, num_envs=TABLES, threads=threads)
        rows.append(row(f"{TABLES} tables, ideal, {threads} threads", many, GOAL_MANY))
    return [*rows, row("one table, firmware", gymnasium.make(NAME, fidelity="firmware"), None)]


def row(name: str, env: Any, goal: float | None) -> Row:
    """Steps of tables per second: the best of some trials, with their resets."""
    tables = getattr(env, "num_envs", 1)
    actions = np.random.default_rng(1).uniform(-0.5, 0.5, (16, *env.action_space.shape))
    actions = actions.astype(np.float32)
    env.reset(seed=1)
    best = 0.0
    for _ in range(TRIALS):
        steps, start = 0, time.perf_counter()
        while (took_s := time.perf_counter() - start) < TRIAL_S:
            _, _, ended, late, _ = env.step(actions[steps % 16])
            steps += 1
            if tables == 1 and (ended or late):
                env.reset()
        best = max(best, steps * tables / took_s)
    env.close()
    return {
        "name": f"environment step, {name}",
        "ours": best,
        "peer": goal,
        "ratio": None if goal is None else best / goal,
        "unit": "steps/s",
    }
