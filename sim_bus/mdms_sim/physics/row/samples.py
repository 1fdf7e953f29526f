"""What the row looked like at given instants, read off its phases."""

from typing import NamedTuple

import numpy as np

from mdms_model.arrays import Floats, Ints
from mdms_model.compiled import compiled
from mdms_model.run.record import Contact
from mdms_sim.physics.row.events import HELD, TIP
from mdms_sim.physics.row.motion import advance
from mdms_sim.physics.row.parcel import (
    ABSENT,
    BACKWARD,
    FORWARD,
    ROLLING,
    Footing,
    Modes,
    RowParcel,
    acceleration,
    footing,
    no_footing,
)
from mdms_sim.physics.row.trace import State, Trace

CONTACT_OF_MODE = {
    ABSENT: Contact.NONE,
    ROLLING: Contact.ROLLING,
    FORWARD: Contact.SLIDING_FORWARD,
    BACKWARD: Contact.SLIDING_BACKWARD,
}


class Course(NamedTuple):
    """Phase, place [m] and speed [m/s] at ascending instants; at an event, just after it."""

    phase: Ints
    x_m: Floats
    speed: Floats


class Loads(NamedTuple):
    """Normal and drive forces [N] of the wheels and their modes, (T, W)."""

    normal_n: Floats
    force_n: Floats
    mode: Modes


@compiled
def course(trace: Trace, times_s: Floats) -> Course:
    """Where a parcel is at ascending instants."""
    phases = np.searchsorted(trace.phases[:, 0], times_s, side="right") - 1
    x_m, speed = np.empty(len(times_s)), np.empty(len(times_s))
    for t, phase in enumerate(phases):
        start_s, start_m, start_speed, pull, beta, gamma = trace.phases[phase]
        dx_m, dv, _ = advance(beta, gamma, start_speed, pull, times_s[t] - start_s)
        x_m[t], speed[t] = start_m + dx_m, start_speed + dv
    return Course(phases, x_m, speed)


@compiled
def loads(row: RowParcel, trace: Trace, way: Course) -> Loads:
    """The wheels' forces on the way."""
    shape = (len(way.x_m), len(row.wheel_x_m))
    found = Loads(np.zeros(shape), np.zeros(shape), np.full(shape, ABSENT, np.int8))
    foot, known = no_footing(row, -1), -1
    for t, phase in enumerate(way.phase):
        cause, k = trace.whys[phase]
        state = State(0.0, way.x_m[t], way.speed[t])
        here = Loads(found.normal_n[t], found.force_n[t], found.mode[t])
        if cause == HELD:
            share_edge(row, k, state, here)
        elif cause != TIP:
            if phase != known:
                foot = footing(row, k, state.x_m, state.speed)
                foot.mode[:] = trace.modes[phase]
                known = phase
            add_forces(row, foot, state, 1.0, here)
    return found


@compiled
def add_forces(row: RowParcel, foot: Footing, state: State, part: float, here: Loads) -> None:
    """Add a part of the forces of what carries."""
    for i in range(foot.first, foot.last + 1):
        load_n = foot.load[0, i] + foot.load[1, i] * state.x_m
        here.mode[i] = foot.mode[i]
        here.normal_n[i] += part * load_n
        if foot.mode[i] == ROLLING:
            here.force_n[i] += part * (row.push_n[i] - row.drag[i] * state.speed)
        else:
            here.force_n[i] += part * foot.mode[i] * row.friction[i] * load_n


@compiled
def share_edge(row: RowParcel, k: int, state: State, here: Loads) -> None:
    """Forces of a parcel held between stretches `k - 1` and `k`: the mean of both that balances.

    The wheel at the very end of the parcel carries just the part that leaves no net force.
    """
    before, after = footing(row, k - 1, state.x_m, 0.0), footing(row, k, state.x_m, 0.0)
    ahead = acceleration(row, before, state.x_m, 0.0)
    back = acceleration(row, after, state.x_m, 0.0)
    add_forces(row, before, state, back / (back - ahead), here)
    add_forces(row, after, state, ahead / (ahead - back), here)
