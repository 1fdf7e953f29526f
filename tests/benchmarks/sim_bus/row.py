"""The paper's figures 7 to 9 on the row: ours beside scipy's LSODA at 1e-8.

Both start from prepared constants and give the parcel's place at the same 1001 instants of 20 s.
LSODA gets its right side as a numpy user writes it, as tight Python, and compiled by numba. Errors
of both are against scipy's DOP853 at its tightest.
"""

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numba
import numpy as np

from mdms_model.array import build_wheels
from mdms_model.arrays import Floats
from mdms_model.motor import drive_of
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import Scenario
from mdms_sim.physics.row.solver import sampled_motion
from mdms_sim.physics.row.trace import row_parcel, trace

FIGURES = (7, 8, 9)
INSTANTS = 1001
TOLERANCE = 1e-8
TIGHT = 3e-14
INSIDE_M = 1e-13  # off the edge, where one more wheel carries for no time at all
LONGEST_STEP_S = 0.05  # without it LSODA's first steps leave the table

Rates = Callable[[float, Any], Any]


def run() -> list[dict[str, Any]]:
    """Wall times of 20 s, ours and LSODA's, and both errors, for each figure and right side."""
    try:
        import scipy.integrate  # noqa: F401
    except ImportError:
        return [{"name": "row: scipy is missing; make bench installs it"}]
    return [row for figure in FIGURES for row in measure(figure)]


def measure(figure: int) -> list[dict[str, Any]]:
    """One row for each way to write LSODA's right side."""
    scenario = load_scenario(f"paper-fig{figure}")
    reference_m_s = -np.sign(build_wheels(scenario).position_m[:, 0]) * scenario.motion.speed_m_s
    times_s = np.linspace(0.0, scenario.run.duration_s, INSTANTS)

    row = row_parcel(scenario, scenario.parcel[0], reference_m_s)

    def ours() -> Floats:
        return sampled_motion(
            trace(row, scenario.parcel[0].x_m, scenario.run.duration_s), times_s
        ).x_m

    own_m, own_s = ours(), best_of(ours, 200)
    sides = right_sides(scenario, reference_m_s)
    tight_m = integrate("DOP853", sides["compiled"], scenario, times_s, TIGHT)
    rows = []
    for name, rates in sides.items():
        peer_m = integrate("LSODA", rates, scenario, times_s, TOLERANCE)
        peer_s = best_of(partial(integrate, "LSODA", rates, scenario, times_s, TOLERANCE), 3)
        rows.append(
            {
                "name": f"figure {figure}: 20 s, LSODA 1e-8 with {name} right side",
                "ours": own_s * 1e3,
                "peer": peer_s * 1e3,
                "ratio": peer_s / own_s,
                "unit": "ms",
                "error_m": float(abs(own_m - tight_m).max()),
                "peer_error_m": float(abs(peer_m - tight_m).max()),
                "real_time_factor": scenario.run.duration_s / own_s,
            }
        )
    return rows


def best_of(work: Callable[[], object], times: int) -> float:
    """Shortest of several runs [s]."""
    shortest_s = np.inf
    for _ in range(times):
        start_s = time.perf_counter()
        work()
        shortest_s = min(shortest_s, time.perf_counter() - start_s)
    return float(shortest_s)


def integrate(
    method: str, rates: Rates, scenario: Scenario, times_s: Floats, tolerance: float
) -> Floats:
    """The parcel's place at the instants, by scipy."""
    from scipy.integrate import solve_ivp

    found = solve_ivp(
        rates,
        (0.0, scenario.run.duration_s),
        (scenario.parcel[0].x_m + INSIDE_M, 0.0),
        method=method,
        t_eval=times_s,
        rtol=tolerance,
        atol=tolerance,
        max_step=LONGEST_STEP_S,
    )
    return np.asarray(found.y[0])


def right_sides(scenario: Scenario, reference_m_s: Floats) -> dict[str, Rates]:
    """(x', v') by eqs (1), (9) and (12), in three ways of writing Python."""
    drive, parcel = drive_of(scenario.cell), scenario.parcel[0]
    places, push, b = build_wheels(scenario).position_m[:, 0], drive.a * reference_m_s, drive.b
    half, mass = parcel.length_m / 2, parcel.mass_kg
    grip = scenario.cell.friction * mass * scenario.run.gravity_m_s2

    def numpy_rates(_t: float, state: Any) -> Any:
        x, v = state
        on = np.abs(places - x) <= half
        under = places[on]
        if len(under) < 2:
            return v, 0.0
        arm = under - under.mean()
        hold = grip * (1 / len(under) + (x - under.mean()) * arm / (arm @ arm))
        return v, np.clip(push[on] - b * v, -hold, hold).sum() / mass

    wheels = list(zip(places.tolist(), push.tolist(), strict=True))

    def python_rates(_t: float, state: Any) -> Any:
        x, v = state
        on = [wheel for wheel in wheels if -half <= wheel[0] - x <= half]
        n = len(on)
        if n < 2:
            return v, 0.0
        mean = sum(place for place, _ in on) / n
        slope = (x - mean) / sum((place - mean) ** 2 for place, _ in on)
        force = 0.0
        for place, pushes in on:
            hold = grip * (1 / n + slope * (place - mean))
            force += min(max(pushes - b * v, -hold), hold)
        return v, force / mass

    @numba.njit
    def compiled_rates(_t: float, state: Any) -> Any:
        x, v = state[0], state[1]
        n, mean, square, force = 0, 0.0, 0.0, 0.0
        for place in places:
            if abs(place - x) <= half:
                n += 1
                mean += place
        if n < 2:
            return np.array((v, 0.0))
        mean /= n
        for place in places:
            if abs(place - x) <= half:
                square += (place - mean) ** 2
        for i in range(len(places)):
            if abs(places[i] - x) <= half:
                hold = grip * (1 / n + (x - mean) * (places[i] - mean) / square)
                force += min(max(push[i] - b * v, -hold), hold)
        return np.array((v, force / mass))

    return {"numpy": numpy_rates, "tight Python": python_rates, "compiled": compiled_rates}
