"""When the next event of a phase comes: a reversal, an edge of the stretch, a wheel's new mode.

A wheel's mode holds while a linear function of place and speed is positive (eq 12). Along a phase
such a function has its extremes at times known in closed form; between them it is monotone, so no
event can hide.
"""

import math
from typing import NamedTuple

from mdms_model.compiled import compiled
from mdms_sim.physics.row.motion import advance, first_zero, half_period
from mdms_sim.physics.row.parcel import ROLLING, Footing, RowParcel

START, SUPPORT, CONTACT, REVERSAL, REST, HELD, TIP, END = range(8)
"""What begins a phase. HELD: at rest on an edge between two support sets that push both ways."""

SLACK = 1e-12
"""Part of the weight that is no force: it separates a crossing from a touch."""
SLACK_M = 1e-13
ROUNDING = 4e-16
CLOSE = 1e-8
"""A Newton step this short leaves an error of its square, which is rounding."""


class Phase(NamedTuple):
    """A stretch of time with one law x'' = alpha + beta x + gamma x', by its start."""

    time_s: float
    x_m: float
    speed: float
    acceleration: float
    beta: float
    gamma: float


class Margin(NamedTuple):
    """A linear function of place and speed; where it falls below -`slack` an event has come."""

    now: float
    by_x: float
    by_v: float
    slack: float


@compiled
def next_event(
    row: RowParcel, foot: Footing, phase: Phase, until_s: float
) -> tuple[float, int, int, int]:
    """How long the phase lasts, what ends it, and for a CONTACT the wheel and its new mode.

    For a SUPPORT the third is the side on which the parcel leaves its stretch, -1 or 1.
    """
    soonest_s, cause, what, becomes = until_s - phase.time_s, END, 0, 0
    turn_s = first_zero(phase.beta, phase.gamma, phase.speed, phase.acceleration)
    if turn_s < soonest_s:
        soonest_s, cause = turn_s, REVERSAL
    heading = phase.speed if phase.speed != 0.0 else phase.acceleration
    if heading != 0.0:
        side = 1 if heading > 0.0 else -1
        at_s = crossing(phase, edge_margin(row, foot, phase, side), soonest_s)
        if at_s < soonest_s:
            soonest_s, cause, what = at_s, SUPPORT, side
    for i in range(foot.first, foot.last + 1):
        for side in (-1, 1):
            if foot.mode[i] == ROLLING or foot.mode[i] == side:
                margin = mode_margin(row, foot, phase, i, side)
                if margin.now > most_change(row, foot, margin, soonest_s):
                    continue
                at_s = crossing(phase, margin, soonest_s)
                if at_s < soonest_s:
                    soonest_s, cause, what = at_s, CONTACT, i
                    becomes = side if foot.mode[i] == ROLLING else ROLLING
    return soonest_s, cause, what, becomes


@compiled
def edge_margin(row: RowParcel, foot: Footing, phase: Phase, side: int) -> Margin:
    """Way left to the edge of the stretch on one side."""
    edge_m = row.edge_m[foot.k + 1] if side > 0 else row.edge_m[foot.k]
    return Margin(side * (edge_m - phase.x_m), -side, 0.0, SLACK_M)


@compiled
def mode_margin(row: RowParcel, foot: Footing, phase: Phase, i: int, side: int) -> Margin:
    """Force by which wheel `i` keeps its mode: friction over a rolling wheel's force, or under.

    A wheel that rolls may slip to either `side`; one that slips to `side` may roll again (eq 12).
    """
    sense = 1.0 if foot.mode[i] == ROLLING else -1.0
    hold_n = row.friction[i] * (foot.load[0, i] + foot.load[1, i] * phase.x_m)
    rolling_n = row.push_n[i] - row.drag[i] * phase.speed
    return Margin(
        sense * (hold_n - side * rolling_n),
        sense * row.friction[i] * foot.load[1, i],
        sense * side * row.drag[i],
        SLACK * row.weight_n,
    )


@compiled
def most_change(row: RowParcel, foot: Footing, margin: Margin, within_s: float) -> float:
    """What a margin cannot change by more than: friction bounds speed, the stretch bounds place."""
    span_m: float = row.edge_m[foot.k + 1] - row.edge_m[foot.k]
    return abs(margin.by_x) * span_m + abs(margin.by_v) * row.most_pull_m_s2 * within_s


@compiled
def crossing(phase: Phase, margin: Margin, until_s: float) -> float:
    """When the margin falls through zero in the phase; `until_s` if not before.

    Only a fall below its slack counts; the time is that of the zero on the way there.
    """
    beta, gamma = phase.beta, phase.gamma
    rate = margin.by_x * phase.speed + margin.by_v * phase.acceleration
    jerk = gamma * phase.acceleration + beta * phase.speed
    bend = margin.by_x * phase.acceleration + margin.by_v * jerk
    extreme_s, swing_s = first_zero(beta, gamma, rate, bend), half_period(beta, gamma)
    low_s = 0.0
    while low_s < until_s:
        high_s = min(extreme_s, until_s)
        value, _ = margin_at(phase, margin, high_s)
        if value < -margin.slack:
            return falling_zero(phase, margin, low_s, high_s)
        low_s, extreme_s = high_s, extreme_s + swing_s
    return until_s


@compiled
def margin_at(phase: Phase, margin: Margin, after_s: float) -> tuple[float, float]:
    """A margin some time into the phase, and its rate."""
    dx_m, dv, acceleration = advance(
        phase.beta, phase.gamma, phase.speed, phase.acceleration, after_s
    )
    value = margin.now + margin.by_x * dx_m + margin.by_v * dv
    return value, margin.by_x * (phase.speed + dv) + margin.by_v * acceleration


@compiled
def falling_zero(phase: Phase, margin: Margin, low_s: float, high_s: float) -> float:
    """The zero of a margin that falls from `low_s` to `high_s`: Newton's steps, kept inside."""
    value, rate = margin_at(phase, margin, low_s)
    if value <= 0.0:
        return low_s
    at_s, step_s = low_s, math.inf
    while abs(step_s) > ROUNDING * high_s and abs(value) > ROUNDING * abs(margin.now):
        newton_s = at_s - value / rate if rate < 0.0 else math.inf
        inside = low_s < newton_s < high_s
        new_s = newton_s if inside else (low_s + high_s) / 2
        step_s, at_s = new_s - at_s, new_s
        if inside and abs(step_s) < CLOSE * high_s:
            break
        value, rate = margin_at(phase, margin, at_s)
        if value > 0.0:
            low_s = at_s
        else:
            high_s = at_s
    return at_s
