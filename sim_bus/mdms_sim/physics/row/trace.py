"""The row from event to event: one parcel's whole motion as phases, each exact."""

from typing import NamedTuple

import numpy as np

from mdms_model.arrays import Floats, Ints
from mdms_model.compiled import compiled
from mdms_model.statics.row_supports import EDGE_M
from mdms_sim.physics.row.events import (
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
from mdms_sim.physics.row.motion import advance
from mdms_sim.physics.row.parcel import (
    Footing,
    Modes,
    RowParcel,
    acceleration,
    carried,
    coefficients,
    footing,
    no_footing,
)

MOST_PHASES = 1_000_000


class Trace(NamedTuple):
    """All phases of a motion in order of time: fields of `Phase`, cause and stretch, modes."""

    phases: Floats
    whys: Ints
    modes: Modes


class State(NamedTuple):
    """Where a parcel is."""

    time_s: float
    x_m: float
    speed: float


@compiled
def trace(row: RowParcel, x_m: float, until_s: float) -> Trace:
    """The motion of a parcel that starts at rest at `x_m`.

    The last phase lasts until `until_s`, or is a TIP. Gives up after MOST_PHASES.
    """
    book = Trace(
        np.zeros((256, 6)), np.zeros((256, 2), np.int64), np.zeros((256, len(row.push_n)), np.int8)
    )
    state = State(0.0, x_m, 0.0)
    foot, cause = start(row, x_m)
    count = 0
    while count < MOST_PHASES:
        phase = begin(row, foot, cause, state)
        book = note(book, count, phase, cause, foot)
        count += 1
        if cause in (HELD, TIP):
            break
        after_s, cause, what, becomes = next_event(row, foot, phase, until_s)
        if cause == END:
            break
        state, pull = coast(phase, after_s)
        if cause == REVERSAL:
            state = State(state.time_s, state.x_m, 0.0)
        elif cause == CONTACT:
            foot.mode[what] = becomes
        else:
            foot, cause, state = cross(row, foot.k, what, state, pull)
    return Trace(book.phases[:count], book.whys[:count], book.modes[:count])


@compiled
def begin(row: RowParcel, foot: Footing, cause: int, state: State) -> Phase:
    """The phase that begins now; one without force keeps the parcel where it rests."""
    alpha, beta, gamma = coefficients(row, foot)
    pull = alpha + beta * state.x_m + gamma * state.speed
    if cause in (HELD, TIP) or (state.speed == 0.0 and negligible(row, pull)):
        return Phase(state.time_s, state.x_m, state.speed, 0.0, 0.0, 0.0)
    return Phase(state.time_s, state.x_m, state.speed, pull, beta, gamma)


@compiled
def negligible(row: RowParcel, pull: float) -> bool:
    """Whether an acceleration is nothing but rounding."""
    return abs(pull) * row.mass_kg <= SLACK * row.weight_n


@compiled
def note(book: Trace, count: int, phase: Phase, cause: int, foot: Footing) -> Trace:
    """Write one more phase; the book grows when it is full."""
    if count == len(book.phases):
        book = Trace(
            np.concatenate((book.phases, np.zeros_like(book.phases))),
            np.concatenate((book.whys, np.zeros_like(book.whys))),
            np.concatenate((book.modes, np.zeros_like(book.modes))),
        )
    rests = cause == REVERSAL and phase.acceleration == 0.0
    book.phases[count] = phase
    book.whys[count] = REST if rests else cause, foot.k
    book.modes[count] = foot.mode
    return book


@compiled
def coast(phase: Phase, after_s: float) -> tuple[State, float]:
    """Where a phase leads, and the acceleration there."""
    dx_m, dv, pull = advance(phase.beta, phase.gamma, phase.speed, phase.acceleration, after_s)
    return State(phase.time_s + after_s, phase.x_m + dx_m, phase.speed + dv), pull


@compiled
def start(row: RowParcel, x_m: float) -> tuple[Footing, int]:
    """On what a parcel at rest at `x_m` sets off; on an edge, the pushes on both sides decide.

    Where they push it apart, it stays as well: both its ends are on wheels, and a row that is the
    same on both sides moves it to neither.
    """
    k = int(np.searchsorted(row.edge_m, x_m + EDGE_M)) - 1
    on_edge = x_m - row.edge_m[max(k, 0)] < EDGE_M and carried(row, k - 1)
    if not carried(row, k) and not on_edge:
        return no_footing(row, k), TIP
    if not on_edge:
        return footing(row, k, x_m, 0.0), START
    before = footing(row, k - 1, x_m, 0.0)
    if not carried(row, k):
        return before, START
    after = footing(row, k, x_m, 0.0)
    ahead, back = acceleration(row, after, x_m, 0.0), acceleration(row, before, x_m, 0.0)
    least = SLACK * row.weight_n / row.mass_kg
    if ahead * back < 0.0 and min(abs(ahead), abs(back)) > least:
        return after, HELD
    return (after if ahead >= -least else before), START


@compiled
def cross(
    row: RowParcel, k: int, side: int, state: State, pull: float
) -> tuple[Footing, int, State]:
    """Go over an edge of stretch `k`: onto what, how that is called, and the state there.

    An edge whose two sides push the parcel back holds it, once it strays less than EDGE_M.
    Without that, ever shorter swings about the edge would go on for ever.
    """
    edge_m = row.edge_m[k + 1] if side > 0 else row.edge_m[k]
    there = State(state.time_s, edge_m, state.speed)
    if not carried(row, k + side):
        return no_footing(row, k + side), TIP, there
    foot = footing(row, k + side, edge_m, state.speed)
    reach = min(side * pull, -side * acceleration(row, foot, edge_m, state.speed))
    if reach > 0.0 and state.speed * state.speed < 2.0 * reach * EDGE_M:
        right = footing(row, max(k, k + side), edge_m, 0.0)
        return right, HELD, State(state.time_s, edge_m, 0.0)
    return foot, SUPPORT, there
