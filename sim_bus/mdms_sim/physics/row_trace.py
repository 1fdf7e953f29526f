"""The row from event to event: one parcel's whole motion as phases, each exact."""

import numpy as np
from numpy.typing import NDArray

from mdms_sim.physics.compiled import compiled
from mdms_sim.physics.row_events import (
    CONTACT,
    END,
    HELD,
    REST,
    REVERSAL,
    SLACK,
    START,
    SUPPORT,
    TIP,
    Phase,
    next_event,
)
from mdms_sim.physics.row_motion import advance
from mdms_sim.physics.row_parcel import ABSENT, Modes, RowParcel, carried, coefficients, enter
from mdms_sim.physics.row_supports import EDGE_M

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

MOST_PHASES = 4_000_000


@compiled
def trace(row: RowParcel, x_m: float, until_s: float) -> tuple[Floats, Ints, Modes]:
    """All phases of a parcel that starts at rest at `x_m`, in order of time.

    Each has a row of numbers (the fields of `Phase`), of integers (cause, stretch) and of the
    wheels' modes. The last lasts until `until_s`, or is a TIP. Gives up after MOST_PHASES.
    """
    wheels = len(row.wheel_x_m)
    numbers, whys = np.zeros((256, 6)), np.zeros((256, 2), np.int64)
    modes = np.zeros((256, wheels), np.int8)
    mode, line = np.full(wheels, ABSENT, np.int8), np.zeros((2, wheels))
    time_s, speed = 0.0, 0.0
    k, cause = start(row, x_m, line, mode)
    for count in range(MOST_PHASES):
        phase = begin(row, k, cause, line, mode, time_s, x_m, speed)
        if count == len(numbers):
            numbers, whys, modes = doubled(numbers), doubled(whys), doubled(modes)
        numbers[count] = phase
        at_rest = cause == REVERSAL and phase.acceleration == 0.0
        whys[count] = REST if at_rest else cause, k
        modes[count] = mode
        if cause in (HELD, TIP):
            break
        after_s, cause, what, becomes = next_event(row, k, line, mode, phase, until_s)
        if cause == END:
            break
        dx_m, dv, before = advance(
            phase.beta, phase.gamma, phase.speed, phase.acceleration, after_s
        )
        time_s, x_m, speed = time_s + after_s, x_m + dx_m, speed + dv
        if cause == REVERSAL:
            speed = 0.0
        elif cause == CONTACT:
            mode[what] = becomes
        else:
            x_m = row.edge_m[k + 1] if what > 0 else row.edge_m[k]
            k, cause, speed = cross(row, k, what, x_m, speed, before, line, mode)
    return numbers[: count + 1], whys[: count + 1], modes[: count + 1]


@compiled
def begin(
    row: RowParcel,
    k: int,
    cause: int,
    line: Floats,
    mode: Modes,
    time_s: float,
    x_m: float,
    speed: float,
) -> Phase:
    """The phase that begins now; one without force keeps the parcel where it rests."""
    if cause in (HELD, TIP):
        return Phase(time_s, x_m, speed, 0.0, 0.0, 0.0)
    alpha, beta, gamma = coefficients(row, k, line, mode)
    acceleration = alpha + beta * x_m + gamma * speed
    if speed == 0.0 and negligible(row, acceleration):
        return Phase(time_s, x_m, speed, 0.0, 0.0, 0.0)
    return Phase(time_s, x_m, speed, acceleration, beta, gamma)


@compiled
def negligible(row: RowParcel, acceleration: float) -> bool:
    """Whether an acceleration is nothing but rounding."""
    return abs(acceleration) * row.mass_kg <= SLACK * row.weight_n


@compiled
def start(row: RowParcel, x_m: float, line: Floats, mode: Modes) -> tuple[int, int]:
    """The stretch in which a parcel at rest at `x_m` sets off; on an edge, its force decides."""
    k = np.searchsorted(row.edge_m, x_m + EDGE_M) - 1
    on_edge = x_m - row.edge_m[max(k, 0)] < EDGE_M
    before, after = np.inf, -np.inf
    if on_edge and carried(row, k - 1):
        before = enter(row, k - 1, x_m, 0.0, line, mode)
    if carried(row, k):
        after = enter(row, k, x_m, 0.0, line, mode)
        if before == np.inf or after >= 0.0 or negligible(row, after):
            return k, START
    if before == np.inf:
        return k, TIP
    if after > -np.inf and before > 0.0 and not negligible(row, before):
        return k, HELD
    enter(row, k - 1, x_m, 0.0, line, mode)
    return k - 1, START


@compiled
def cross(
    row: RowParcel,
    k: int,
    side: int,
    x_m: float,
    speed: float,
    before: float,
    line: Floats,
    mode: Modes,
) -> tuple[int, int, float]:
    """Go over an edge of stretch `k`: the next stretch, what that is, and the speed there.

    An edge whose two sides push the parcel together holds it, once it strays less than EDGE_M.
    Without that, ever shorter swings about the edge would go on for ever.
    """
    if not carried(row, k + side):
        return k + side, TIP, speed
    after = enter(row, k + side, x_m, speed, line, mode)
    reach = min(side * before, -side * after)
    if reach > 0.0 and speed * speed < 2.0 * reach * EDGE_M:
        return max(k, k + side), HELD, 0.0
    return k + side, SUPPORT, speed


@compiled
def doubled(table: NDArray[np.generic]) -> NDArray[np.generic]:
    """The same table with room for as many rows again."""
    return np.concatenate((table, np.zeros_like(table)))
