"""What the row looked like at given instants, read off its phases."""

import numpy as np
from numpy.typing import NDArray

from mdms_sim.physics.compiled import compiled
from mdms_sim.physics.row_events import HELD, TIP
from mdms_sim.physics.row_motion import advance
from mdms_sim.physics.row_parcel import (
    ABSENT,
    BACKWARD,
    FORWARD,
    ROLLING,
    Modes,
    RowParcel,
    coefficients,
    enter,
    load_line,
)
from mdms_sim.record import Contact

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CONTACT_OF_MODE = {
    ABSENT: Contact.NONE,
    ROLLING: Contact.ROLLING,
    FORWARD: Contact.SLIDING_FORWARD,
    BACKWARD: Contact.SLIDING_BACKWARD,
}


@compiled
def places(numbers: Floats, times_s: Floats) -> tuple[Ints, Floats, Floats]:
    """The phase, the place [m] and the speed [m/s] at ascending instants; after an event, at one."""
    phases = np.searchsorted(numbers[:, 0], times_s, side="right") - 1
    x_m, speed = np.empty(len(times_s)), np.empty(len(times_s))
    for t, phase in enumerate(phases):
        start_s, start_m, start_speed, acceleration, beta, gamma = numbers[phase]
        dx_m, dv, _ = advance(beta, gamma, start_speed, acceleration, times_s[t] - start_s)
        x_m[t], speed[t] = start_m + dx_m, start_speed + dv
    return phases, x_m, speed


@compiled
def loads(
    row: RowParcel, whys: Ints, modes: Modes, phases: Ints, x_m: Floats, speed: Floats
) -> tuple[Floats, Floats, Modes]:
    """Normal and drive forces [N] of the wheels at the instants of `places`, and their modes."""
    shape = (len(x_m), len(row.wheel_x_m))
    normal_n, force_n = np.zeros(shape), np.zeros(shape)
    mode = np.full(shape, ABSENT, np.int8)
    line, known = np.zeros((2, shape[1])), -1
    for t, phase in enumerate(phases):
        cause, k = whys[phase]
        if cause == TIP:
            continue
        if cause == HELD:
            share_edge(row, k, x_m[t], line, normal_n[t], force_n[t], mode[t])
            known = -1
            continue
        if k != known:
            load_line(row, k, line)
            known = k
        mode[t] = modes[phase]
        add_forces(row, k, line, mode[t], x_m[t], speed[t], 1.0, normal_n[t], force_n[t])
    return normal_n, force_n, mode


@compiled
def add_forces(
    row: RowParcel,
    k: int,
    line: Floats,
    mode: Modes,
    x_m: float,
    speed: float,
    part: float,
    normal_n: Floats,
    force_n: Floats,
) -> None:
    """Add a part of the wheels' forces in stretch `k`."""
    for i in range(row.first[k], row.last[k] + 1):
        load_n = line[0, i] + line[1, i] * x_m
        normal_n[i] += part * load_n
        if mode[i] == ROLLING:
            force_n[i] += part * (row.push_n[i] - row.drag * speed)
        else:
            force_n[i] += part * mode[i] * row.friction * load_n


@compiled
def share_edge(
    row: RowParcel,
    k: int,
    x_m: float,
    line: Floats,
    normal_n: Floats,
    force_n: Floats,
    mode: Modes,
) -> None:
    """Forces of a parcel held between stretches `k - 1` and `k`: the mean of both that balances.

    The wheel at the very end of the parcel carries just the part that leaves no net force.
    """
    before = enter(row, k - 1, x_m, 0.0, line, mode)
    after = enter(row, k, x_m, 0.0, line, mode)
    for j, part in ((k - 1, -after / (before - after)), (k, before / (before - after))):
        both = mode.copy()
        enter(row, j, x_m, 0.0, line, mode)
        add_forces(row, j, line, mode, x_m, 0.0, part, normal_n, force_n)
        for i in range(len(mode)):
            mode[i] = both[i] if mode[i] == ABSENT else mode[i]
