"""The forces on one parcel of the row, and when the next event of a phase comes.

An event is a reversal, an edge of the stretch, or a wheel's new mode. A wheel's mode holds while a
linear function of place and speed is positive (eq 12). Along a phase such a function has its
extremes at times known in closed form; between them it is monotone, so no event can hide.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdms_model.arrays import Floats, Ints
from mdms_model.compiled import compiled
from mdms_model.statics.supports import spread
from mdms_sim.physics.row.motion import advance, first_zero, half_period

Modes = NDArray[np.int8]

BACKWARD, ROLLING, FORWARD, ABSENT = -1, 0, 1, 2
"""What a wheel does: slides pushing back, rolls, slides pushing ahead, or carries nothing."""


class RowParcel(NamedTuple):
    """A parcel and the row under it, as the compiled loops take them [m, N, kg, N s/m]."""

    edge_m: Floats
    first: Ints
    last: Ints
    wheel_x_m: Floats
    push_n: Floats
    """a r of every wheel."""
    drag: Floats
    """b of every wheel, the force lost per speed."""
    friction: Floats
    most_pull_m_s2: float
    """Acceleration that friction at its best cannot exceed."""
    weight_n: float
    mass_kg: float
    com_m: float


class CarryingWheels(NamedTuple):
    """The wheels `first` to `last` that carry in stretch `k`: their loads and their modes.

    Wheel i carries load[0, i] + load[1, i] x [N], x the parcel's place (eq 1).
    """

    k: int
    first: int
    last: int
    load: Floats
    mode: Modes


@compiled
def carried(row: RowParcel, k: int) -> bool:
    """Whether the parcel has supports on both sides of its centre of mass in stretch `k`."""
    return 0 <= k < len(row.first) and row.first[k] <= row.last[k]


@compiled
def footing(row: RowParcel, k: int, x_m: float, speed: float) -> CarryingWheels:
    """The carrying wheels in stretch `k`; each wheel rolls where friction can hold it (eq 12)."""
    wheels = len(row.wheel_x_m)
    load, mode = np.zeros((2, wheels)), np.full(wheels, ABSENT, np.int8)
    first, last = row.first[k], row.last[k]
    mean_m, spread_m2 = spread(row.wheel_x_m, first, last)
    for i in range(first, last + 1):
        slope = row.weight_n * (row.wheel_x_m[i] - mean_m) / spread_m2
        load[0, i] = row.weight_n / (last - first + 1) + slope * (row.com_m - mean_m)
        load[1, i] = slope
        hold_n = row.friction[i] * (load[0, i] + slope * x_m)
        rolling_n = row.push_n[i] - row.drag[i] * speed
        mode[i] = FORWARD if rolling_n > hold_n else BACKWARD if rolling_n < -hold_n else ROLLING
    return CarryingWheels(k, first, last, load, mode)


@compiled
def no_footing(row: RowParcel, k: int) -> CarryingWheels:
    """A stretch in which nothing carries."""
    wheels = len(row.wheel_x_m)
    return CarryingWheels(k, 0, -1, np.zeros((2, wheels)), np.full(wheels, ABSENT, np.int8))


@compiled
def coefficients(row: RowParcel, foot: CarryingWheels) -> tuple[float, float, float]:
    """Of x'' = alpha + beta x + gamma x': eq (6) where wheels slide, eq (11) where they roll."""
    force_n, spring, damping = 0.0, 0.0, 0.0
    for i in range(foot.first, foot.last + 1):
        if foot.mode[i] == ROLLING:
            force_n += row.push_n[i]
            damping += row.drag[i]
        else:
            force_n += foot.mode[i] * row.friction[i] * foot.load[0, i]
            spring += foot.mode[i] * row.friction[i] * foot.load[1, i]
    return force_n / row.mass_kg, spring / row.mass_kg, -damping / row.mass_kg


@compiled
def acceleration(row: RowParcel, foot: CarryingWheels, x_m: float, speed: float) -> float:
    """Of the parcel, from eqs (6) and (11) [m/s^2]."""
    alpha, beta, gamma = coefficients(row, foot)
    return alpha + beta * x_m + gamma * speed


START, SUPPORT, CONTACT, REVERSAL, REST, HELD, TIP, END = range(8)
"""What begins a phase. HELD: at rest on an edge between two support sets that push both ways."""

SLACK = 1e-12
"""Part of the weight that is no force: it separates a crossing from a touch."""
SLACK_M = 1e-13
ROUNDING = 4e-16
CLOSE = 1e-8
"""A Newton step this short leaves an error of its square, which is rounding."""


class MotionPhase(NamedTuple):
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
    row: RowParcel, foot: CarryingWheels, phase: MotionPhase, until_s: float
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
def edge_margin(row: RowParcel, foot: CarryingWheels, phase: MotionPhase, side: int) -> Margin:
    """Way left to the edge of the stretch on one side."""
    edge_m = row.edge_m[foot.k + 1] if side > 0 else row.edge_m[foot.k]
    return Margin(side * (edge_m - phase.x_m), -side, 0.0, SLACK_M)


@compiled
def mode_margin(
    row: RowParcel, foot: CarryingWheels, phase: MotionPhase, i: int, side: int
) -> Margin:
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
def most_change(row: RowParcel, foot: CarryingWheels, margin: Margin, within_s: float) -> float:
    """A bound on the change of a margin: friction bounds speed, the stretch bounds place."""
    span_m: float = row.edge_m[foot.k + 1] - row.edge_m[foot.k]
    return abs(margin.by_x) * span_m + abs(margin.by_v) * row.most_pull_m_s2 * within_s


@compiled
def crossing(phase: MotionPhase, margin: Margin, until_s: float) -> float:
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
def margin_at(phase: MotionPhase, margin: Margin, after_s: float) -> tuple[float, float]:
    """A margin some time into the phase, and its rate."""
    dx_m, dv, acceleration = advance(
        phase.beta, phase.gamma, phase.speed, phase.acceleration, after_s
    )
    value = margin.now + margin.by_x * dx_m + margin.by_v * dv
    return value, margin.by_x * (phase.speed + dv) + margin.by_v * acceleration


@compiled
def falling_zero(phase: MotionPhase, margin: Margin, low_s: float, high_s: float) -> float:
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
