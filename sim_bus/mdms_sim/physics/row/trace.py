"""The row from event to event: one parcel's whole journey as phases, each exact."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mdms_model.array import build_wheels
from mdms_model.arrays import Floats, Ints
from mdms_model.compiled import compiled
from mdms_model.motor import drive_of
from mdms_model.outline import chord_m
from mdms_model.run.record import Event
from mdms_model.scenario.scenario import Parcel, Scenario, ScenarioError
from mdms_model.statics.supports import EDGE_M, stretches_of
from mdms_sim.physics.motor import true_cells
from mdms_sim.physics.row.events import (
    ABSENT,
    BACKWARD,
    CONTACT,
    END,
    FORWARD,
    HELD,
    REST,
    REVERSAL,
    ROLLING,
    SLACK,
    START,
    SUPPORT,
    TIP,
    CarryingWheels,
    Modes,
    MotionPhase,
    RowParcel,
    acceleration,
    carried,
    coefficients,
    footing,
    next_event,
    no_footing,
)
from mdms_sim.physics.row.motion import advance

MOST_PHASES = 1_000_000


class Trace(NamedTuple):
    """All phases of a motion in order of time: fields of `Phase`, cause and stretch, modes."""

    phases: Floats
    whys: Ints
    modes: Modes


class RowState(NamedTuple):
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
    state = RowState(0.0, x_m, 0.0)
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
            state = RowState(state.time_s, state.x_m, 0.0)
        elif cause == CONTACT:
            foot.mode[what] = becomes
        else:
            foot, cause, state = cross(row, foot.k, what, state, pull)
    return Trace(book.phases[:count], book.whys[:count], book.modes[:count])


@compiled
def begin(row: RowParcel, foot: CarryingWheels, cause: int, state: RowState) -> MotionPhase:
    """The phase that begins now; one without force keeps the parcel where it rests."""
    alpha, beta, gamma = coefficients(row, foot)
    pull = alpha + beta * state.x_m + gamma * state.speed
    if cause in (HELD, TIP) or (state.speed == 0.0 and negligible(row, pull)):
        return MotionPhase(state.time_s, state.x_m, state.speed, 0.0, 0.0, 0.0)
    return MotionPhase(state.time_s, state.x_m, state.speed, pull, beta, gamma)


@compiled
def negligible(row: RowParcel, pull: float) -> bool:
    """Whether an acceleration is nothing but rounding."""
    return abs(pull) * row.mass_kg <= SLACK * row.weight_n


@compiled
def note(book: Trace, count: int, phase: MotionPhase, cause: int, foot: CarryingWheels) -> Trace:
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
def coast(phase: MotionPhase, after_s: float) -> tuple[RowState, float]:
    """Where a phase leads, and the acceleration there."""
    dx_m, dv, pull = advance(phase.beta, phase.gamma, phase.speed, phase.acceleration, after_s)
    return RowState(phase.time_s + after_s, phase.x_m + dx_m, phase.speed + dv), pull


@compiled
def start(row: RowParcel, x_m: float) -> tuple[CarryingWheels, int]:
    """The stretch on which a parcel at rest at `x_m` sets off.

    On an edge, the pushes on both sides decide.

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
    row: RowParcel, k: int, side: int, state: RowState, pull: float
) -> tuple[CarryingWheels, int, RowState]:
    """Go over an edge of stretch `k`: onto what, how that is called, and the state there.

    An edge whose two sides push the parcel back holds it, once it strays less than EDGE_M.
    Without that, ever shorter swings about the edge would go on for ever.
    """
    edge_m = row.edge_m[k + 1] if side > 0 else row.edge_m[k]
    there = RowState(state.time_s, edge_m, state.speed)
    if not carried(row, k + side):
        return no_footing(row, k + side), TIP, there
    foot = footing(row, k + side, edge_m, state.speed)
    reach = min(side * pull, -side * acceleration(row, foot, edge_m, state.speed))
    if reach > 0.0 and state.speed * state.speed < 2.0 * reach * EDGE_M:
        right = footing(row, max(k, k + side), edge_m, 0.0)
        return right, HELD, RowState(state.time_s, edge_m, 0.0)
    return foot, SUPPORT, there


NEW_MODE = {
    ROLLING: "starts to roll",
    FORWARD: "starts to slip, pushing ahead",
    BACKWARD: "starts to slip, pushing back",
}


@dataclass(frozen=True, slots=True)
class Journey:
    """A parcel's motion, from rest to the end of the run or until it tips."""

    parcel: Parcel
    row: RowParcel
    trace: Trace

    @property
    def tip_s(self) -> float:
        """When the parcel tips; inf where it does not."""
        return float(self.trace.phases[-1, 0]) if self.trace.whys[-1, 0] == TIP else np.inf


def journey_of(scenario: Scenario, parcel: Parcel, reference_m_s: Floats) -> Journey:
    """Trace one parcel from rest over the scenario's duration, as if it were alone.

    Raises `ScenarioError` when it has more events than can be kept.
    """
    row = row_parcel(scenario, parcel, reference_m_s)
    found = trace(row, parcel.x_m, scenario.run.duration_s)
    if len(found.phases) == MOST_PHASES:
        raise ScenarioError(
            f"parcel {parcel.name!r} has {MOST_PHASES} events in {found.phases[-1, 0]:.3g} s, "
            "which is all that can be kept; take a shorter run.duration_s"
        )
    return Journey(parcel, row, found)


def row_parcel(scenario: Scenario, parcel: Parcel, reference_m_s: Floats) -> RowParcel:
    """The row as one parcel meets it; wheels beside the parcel do not count."""
    wheels, cells = build_wheels(scenario), true_cells(scenario)
    drives = [drive_of(cell) for cell in cells]
    friction = np.array([cell.friction for cell in cells])
    wheel_x_m = np.ascontiguousarray(wheels.position_m[:, 0])
    ends_m = chord_m(parcel, float(wheels.position_m[0, 1]) - parcel.y_m)
    com_m = parcel.centre_of_mass_m[0]
    stretches = stretches_of(wheel_x_m, ends_m, com_m)
    return RowParcel(
        edge_m=stretches.edge_m,
        first=stretches.first,
        last=stretches.last,
        wheel_x_m=wheel_x_m,
        push_n=np.array([drive.a for drive in drives]) * reference_m_s,
        drag=np.array([drive.b for drive in drives]),
        friction=friction,
        most_pull_m_s2=float(friction.max()) * scenario.run.gravity_m_s2,
        weight_n=parcel.mass_kg * scenario.run.gravity_m_s2,
        mass_kg=parcel.mass_kg,
        com_m=com_m,
    )


def events_of(journey: Journey) -> Iterator[Event]:
    """The events on the way, in order of time."""
    for at in range(len(journey.trace.phases)):
        cause = journey.trace.whys[at, 0]
        if cause == REVERSAL:
            yield _event(journey, at, "reversal", f"turns at {journey.trace.phases[at, 1]:+.6f} m")
        elif cause == TIP:
            where = f"at x {journey.trace.phases[at, 1]:.4f} m"
            detail = f"the supports no longer hold its centre of mass, {where}"
            yield _event(journey, at, "tip", detail)
            return
        elif cause == HELD:
            where_m = journey.trace.phases[at, 1]
            yield _event(journey, at, "support", f"rests on an edge at {where_m:+.6f} m")
        if at > 0 and cause != HELD:
            yield from _wheel_events(journey, at)


def _wheel_events(journey: Journey, at: int) -> Iterator[Event]:
    before, after = journey.trace.modes[at - 1], journey.trace.modes[at]
    for wheel in np.flatnonzero(before != after).tolist():
        if before[wheel] == ABSENT:
            yield _event(journey, at, "support", "takes load", wheel)
        elif after[wheel] == ABSENT:
            yield _event(journey, at, "support", "is left", wheel)
        else:
            yield _event(journey, at, "contact", NEW_MODE[int(after[wheel])], wheel)


def _event(journey: Journey, at: int, kind: str, detail: str, wheel: int | None = None) -> Event:
    cell, axis = (None, None) if wheel is None else (wheel + 1, 1)
    return Event(float(journey.trace.phases[at, 0]), kind, detail, journey.parcel.name, cell, axis)
