"""The forces on one parcel of the row, for a place, a speed and the modes of its wheels."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdms_sim.physics.compiled import compiled
from mdms_sim.physics.row_supports import spread

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
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
    drag: float
    """b, the force lost per speed."""
    friction: float
    weight_n: float
    mass_kg: float
    com_m: float


@compiled
def carried(row: RowParcel, k: int) -> bool:
    """Whether the parcel has supports on both sides of its centre of mass in stretch `k`."""
    return 0 <= k < len(row.first) and row.first[k] <= row.last[k]


@compiled
def load_line(row: RowParcel, k: int, line: Floats) -> None:
    """Write the normal forces in stretch `k` as N_i = line[0, i] + line[1, i] x (eq 1)."""
    first, last = row.first[k], row.last[k]
    mean_m, spread_m2 = spread(row.wheel_x_m, first, last)
    for i in range(first, last + 1):
        slope = row.weight_n * (row.wheel_x_m[i] - mean_m) / spread_m2
        line[0, i] = row.weight_n / (last - first + 1) + slope * (row.com_m - mean_m)
        line[1, i] = slope


@compiled
def classify(row: RowParcel, k: int, line: Floats, x_m: float, speed: float, mode: Modes) -> None:
    """Write what every wheel does in stretch `k`: it rolls where friction can hold it (eq 12)."""
    mode[:] = ABSENT
    for i in range(row.first[k], row.last[k] + 1):
        hold_n = row.friction * (line[0, i] + line[1, i] * x_m)
        rolling_n = row.push_n[i] - row.drag * speed
        mode[i] = FORWARD if rolling_n > hold_n else BACKWARD if rolling_n < -hold_n else ROLLING


@compiled
def coefficients(row: RowParcel, k: int, line: Floats, mode: Modes) -> tuple[float, float, float]:
    """The phase's x'' = alpha + beta x + gamma x', from eq (6) where wheels slide and eq (11)."""
    force_n, spring, damping = 0.0, 0.0, 0.0
    for i in range(row.first[k], row.last[k] + 1):
        if mode[i] == ROLLING:
            force_n += row.push_n[i]
            damping += row.drag
        else:
            force_n += mode[i] * row.friction * line[0, i]
            spring += mode[i] * row.friction * line[1, i]
    return force_n / row.mass_kg, spring / row.mass_kg, -damping / row.mass_kg


@compiled
def enter(row: RowParcel, k: int, x_m: float, speed: float, line: Floats, mode: Modes) -> float:
    """Take on the supports of stretch `k`; the parcel's acceleration on them [m/s^2]."""
    load_line(row, k, line)
    classify(row, k, line, x_m, speed, mode)
    alpha, beta, gamma = coefficients(row, k, line, mode)
    return alpha + beta * x_m + gamma * speed
