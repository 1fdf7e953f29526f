"""When the next event of a phase comes: a reversal, an edge of the stretch, a wheel's new mode.

A wheel's mode holds while a linear function of place and speed is positive (eq 12). Along a phase
such a function has its extremes at times known in closed form; between them it is monotone, so no
event can hide.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdms_sim.physics.compiled import compiled
from mdms_sim.physics.row_motion import advance, first_zero, half_period
from mdms_sim.physics.row_parcel import ROLLING, Modes, RowParcel

Floats = NDArray[np.float64]

START, SUPPORT, CONTACT, REVERSAL, REST, HELD, TIP, END = range(8)
"""What begins a phase. HELD: at rest on an edge between two support sets that push it together."""

SLACK = 1e-12
"""Part of the weight that is no force: it tells a crossing from a touch."""
SLACK_M = 1e-13


class Phase(NamedTuple):
    """A stretch of time with one law x'' = alpha + beta x + gamma x', by its start."""

    time_s: float
    x_m: float
    speed: float
    acceleration: float
    beta: float
    gamma: float


@compiled
def next_event(
    row: RowParcel, k: int, line: Floats, mode: Modes, phase: Phase, until_s: float
) -> tuple[float, int, int, int]:
    """How long the phase lasts, what ends it, and for a CONTACT the wheel and its new mode.

    For a SUPPORT the third is the side on which the parcel leaves stretch `k`, -1 or 1.
    """
    soonest_s, cause, what, becomes = until_s - phase.time_s, END, 0, 0
    turn_s = first_zero(phase.beta, phase.gamma, phase.speed, phase.acceleration)
    if turn_s < soonest_s:
        soonest_s, cause = turn_s, REVERSAL
    heading = phase.speed if phase.speed != 0.0 else phase.acceleration
    if heading != 0.0:
        side = 1 if heading > 0.0 else -1
        edge_m = row.edge_m[k + 1] if side > 0 else row.edge_m[k]
        at_s = crossing(phase, side * (edge_m - phase.x_m), -side, 0.0, SLACK_M, soonest_s)
        if at_s < soonest_s:
            soonest_s, cause, what = at_s, SUPPORT, side
    slack_n = SLACK * row.weight_n
    for i in range(row.first[k], row.last[k] + 1):
        hold_n = row.friction * (line[0, i] + line[1, i] * phase.x_m)
        hold_slope = row.friction * line[1, i]
        rolling_n = row.push_n[i] - row.drag * phase.speed
        for side in (-1, 1):
            if mode[i] != ROLLING and mode[i] != side:
                continue
            sense = 1.0 if mode[i] == ROLLING else -1.0
            margin_n = sense * (hold_n - side * rolling_n)
            by_x, by_v = sense * hold_slope, sense * side * row.drag
            at_s = crossing(phase, margin_n, by_x, by_v, slack_n, soonest_s)
            if at_s < soonest_s:
                soonest_s, cause, what = at_s, CONTACT, i
                becomes = side if mode[i] == ROLLING else ROLLING
    return soonest_s, cause, what, becomes


@compiled
def crossing(
    phase: Phase, margin: float, by_x: float, by_v: float, slack: float, until_s: float
) -> float:
    """When margin + by_x dx + by_v dv falls through zero in the phase; `until_s` if not before.

    Only a fall below -`slack` counts; its time is that of the zero on the way there.
    """
    beta, gamma = phase.beta, phase.gamma
    rate = by_x * phase.speed + by_v * phase.acceleration
    bend = by_x * phase.acceleration + by_v * (gamma * phase.acceleration + beta * phase.speed)
    extreme_s, swing_s = first_zero(beta, gamma, rate, bend), half_period(beta, gamma)
    low_s = 0.0
    while low_s < until_s:
        high_s = min(extreme_s, until_s)
        dx_m, dv, _ = advance(beta, gamma, phase.speed, phase.acceleration, high_s)
        if margin + by_x * dx_m + by_v * dv < -slack:
            return zero_between(phase, margin, by_x, by_v, low_s, high_s)
        low_s, extreme_s = high_s, extreme_s + swing_s
    return until_s


@compiled
def zero_between(
    phase: Phase, margin: float, by_x: float, by_v: float, low_s: float, high_s: float
) -> float:
    """The zero of a margin that falls from `low_s` to `high_s`: Newton's steps, kept inside."""
    beta, gamma = phase.beta, phase.gamma
    at_s = low_s
    for _ in range(200):
        dx_m, dv, acceleration = advance(beta, gamma, phase.speed, phase.acceleration, at_s)
        value = margin + by_x * dx_m + by_v * dv
        if value > 0.0:
            low_s = at_s
        elif at_s == low_s:
            return at_s
        else:
            high_s = at_s
        slope = by_x * (phase.speed + dv) + by_v * acceleration
        before_s = at_s
        at_s = at_s - value / slope if slope < 0.0 else (low_s + high_s) / 2
        if not low_s <= at_s <= high_s:
            at_s = (low_s + high_s) / 2
        if abs(at_s - before_s) <= 2e-16 * high_s:
            break
    return at_s
