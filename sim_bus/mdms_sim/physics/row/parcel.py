"""The forces on one parcel of the row, for a place, a speed and the modes of its wheels."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdms_model.arrays import Floats, Ints
from mdms_model.compiled import compiled
from mdms_model.statics.row_supports import spread

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


class Footing(NamedTuple):
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
def footing(row: RowParcel, k: int, x_m: float, speed: float) -> Footing:
    """What carries in stretch `k`; each wheel rolls where friction can hold it (eq 12)."""
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
    return Footing(k, first, last, load, mode)


@compiled
def no_footing(row: RowParcel, k: int) -> Footing:
    """A stretch in which nothing carries."""
    wheels = len(row.wheel_x_m)
    return Footing(k, 0, -1, np.zeros((2, wheels)), np.full(wheels, ABSENT, np.int8))


@compiled
def coefficients(row: RowParcel, foot: Footing) -> tuple[float, float, float]:
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
def acceleration(row: RowParcel, foot: Footing, x_m: float, speed: float) -> float:
    """Of the parcel, from eqs (6) and (11) [m/s^2]."""
    alpha, beta, gamma = coefficients(row, foot)
    return alpha + beta * x_m + gamma * speed
