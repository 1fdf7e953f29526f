"""The paper's one-dimensional model, solved exactly from event to event.

One row of cells with one massless wheel each under the continuous proportional law, Coulomb
friction, and parcels that slide along the row. `run.step_s` only spaces the record's samples; every
event is a sample of its own.
"""

import math
from itertools import chain, pairwise
from typing import NamedTuple

import numpy as np

from mdms_model.array import build_wheels
from mdms_model.arrays import Floats, Ints
from mdms_model.compiled import compiled
from mdms_model.motor import drive_of
from mdms_model.run.record import Contact, Record
from mdms_model.scenario.scenario import Scenario, ScenarioError
from mdms_sim.physics.motor import true_cells
from mdms_sim.physics.row.events import (
    ABSENT,
    BACKWARD,
    FORWARD,
    HELD,
    ROLLING,
    TIP,
    CarryingWheels,
    Modes,
    RowParcel,
    acceleration,
    footing,
    no_footing,
)
from mdms_sim.physics.row.motion import advance
from mdms_sim.physics.row.trace import Journey, RowState, Trace, events_of, journey_of

CONTACT_OF_MODE = {
    ABSENT: Contact.NONE,
    ROLLING: Contact.ROLLING,
    FORWARD: Contact.SLIDING_FORWARD,
    BACKWARD: Contact.SLIDING_BACKWARD,
}


class SampledMotion(NamedTuple):
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
def sampled_motion(trace: Trace, times_s: Floats) -> SampledMotion:
    """Where a parcel is at ascending instants."""
    phases = np.searchsorted(trace.phases[:, 0], times_s, side="right") - 1
    x_m, speed = np.empty(len(times_s)), np.empty(len(times_s))
    for t, phase in enumerate(phases):
        start_s, start_m, start_speed, pull, beta, gamma = trace.phases[phase]
        dx_m, dv, _ = advance(beta, gamma, start_speed, pull, times_s[t] - start_s)
        x_m[t], speed[t] = start_m + dx_m, start_speed + dv
    return SampledMotion(phases, x_m, speed)


@compiled
def loads(row: RowParcel, trace: Trace, way: SampledMotion) -> Loads:
    """The wheels' forces on the way."""
    shape = (len(way.x_m), len(row.wheel_x_m))
    found = Loads(np.zeros(shape), np.zeros(shape), np.full(shape, ABSENT, np.int8))
    foot, known = no_footing(row, -1), -1
    for t, phase in enumerate(way.phase):
        cause, k = trace.whys[phase]
        state = RowState(0.0, way.x_m[t], way.speed[t])
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
def add_forces(
    row: RowParcel, foot: CarryingWheels, state: RowState, part: float, here: Loads
) -> None:
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
def share_edge(row: RowParcel, k: int, state: RowState, here: Loads) -> None:
    """Forces of a parcel held between stretches `k - 1` and `k`: the mean of both that balances.

    The wheel at the very end of the parcel carries just the part that leaves no net force.
    """
    before, after = footing(row, k - 1, state.x_m, 0.0), footing(row, k, state.x_m, 0.0)
    ahead = acceleration(row, before, state.x_m, 0.0)
    back = acceleration(row, after, state.x_m, 0.0)
    add_forces(row, before, state, back / (back - ahead), here)
    add_forces(row, after, state, ahead / (ahead - back), here)


def solve_row(scenario: Scenario, reference_m_s: Floats) -> Record:
    """The whole run under constant references of shape (W,).

    A parcel that tips ends the run, with a 'tip' event. Raises `ScenarioError` where the scenario
    is no row, or parcels touch.
    """
    check_row(scenario)
    journeys = [journey_of(scenario, parcel, reference_m_s) for parcel in scenario.parcel]
    record = _blank(scenario, reference_m_s, _instants(scenario, journeys))
    for number, journey in enumerate(journeys):
        _write(record, number, journey)
    _derive_wheels(scenario, record)
    _check_apart(scenario, record)
    events = sorted(chain.from_iterable(map(events_of, journeys)), key=lambda event: event.time_s)
    record.events = [event for event in events if event.time_s <= record.time_s[-1]]
    return record


def check_row(scenario: Scenario) -> None:
    """Refuse scenarios beyond the paper's row. Raises `ScenarioError`."""
    _refuse("array.rows", scenario.array.rows, 1)
    wheels, cells = build_wheels(scenario), true_cells(scenario)
    _refuse("number of wheels in a cell", max(len(cell.wheel) for cell in cells), 1)
    _refuse("cosine of a wheel's direction", float(wheels.direction[:, 0].min()), 1.0)
    _refuse("distance of wheels across the row", float(np.ptp(wheels.position_m[:, 1])), 0.0)
    _refuse(
        "cell.viscous_friction_s_per_m", max(cell.viscous_friction_s_per_m for cell in cells), 0.0
    )
    for number, parcel in enumerate(scenario.parcel):
        _refuse(f"parcel.{number}.yaw_rad", parcel.yaw_rad, 0.0)


def _refuse(key: str, value: float, wanted: float) -> None:
    if value != wanted:
        raise ScenarioError(
            f"{key} is {value}, but the row needs {wanted}; "
            "set run.fidelity to 'ideal' or 'firmware' for anything else"
        )


def _instants(scenario: Scenario, journeys: list[Journey]) -> Floats:
    """Samples at every `step_s`, at every event, and at the end."""
    run = scenario.run
    end_s = min([run.duration_s, *(journey.tip_s for journey in journeys)])
    grid_s = np.arange(math.floor(run.duration_s / run.step_s * (1 + 1e-12)) + 1) * run.step_s
    times_s = np.concatenate(
        [grid_s, [end_s], *(journey.trace.phases[:, 0] for journey in journeys)]
    )
    times_s = np.unique(times_s)
    return times_s[times_s <= end_s]


def _blank(scenario: Scenario, reference_m_s: Floats, time_s: Floats) -> Record:
    """A record of parcels at rest where they start and of wheels that carry nothing."""
    instants, wheels = len(time_s), scenario.array.columns
    start = np.array([(p.x_m, p.y_m, p.yaw_rad) for p in scenario.parcel]).reshape(-1, 3)
    pose = np.repeat(start[np.newaxis], instants, axis=0)
    reference = np.repeat(np.asarray(reference_m_s, dtype=np.float64)[np.newaxis], instants, axis=0)
    return Record(
        time_s=time_s,
        pose=pose,
        twist=np.zeros_like(pose),
        reference_m_s=reference,
        speed_m_s=np.zeros((instants, wheels)),
        voltage_v=np.zeros((instants, wheels)),
        normal_n=np.zeros((instants, wheels)),
        force_n=np.zeros((instants, wheels)),
        contact=np.full((instants, wheels), Contact.NONE, dtype=np.int8),
    )


def _write(record: Record, number: int, journey: Journey) -> None:
    """Write one parcel, and the wheels while it is on them."""
    way = sampled_motion(journey.trace, record.time_s)
    found = loads(journey.row, journey.trace, way)
    record.pose[:, number, 0] = way.x_m
    record.twist[:, number, 0] = way.speed
    record.normal_n += found.normal_n
    record.force_n += found.force_n
    for code, contact in CONTACT_OF_MODE.items():
        if contact != Contact.NONE:
            record.contact[found.mode == code] = contact


def _derive_wheels(scenario: Scenario, record: Record) -> None:
    """Surface speeds and voltages that go with the forces (eq 9 and V = G (r - v))."""
    drives = [drive_of(cell) for cell in true_cells(scenario)]
    a, b = (np.array([getattr(drive, name) for drive in drives]) for name in "ab")
    record.speed_m_s = (a * record.reference_m_s - record.force_n) / b
    record.voltage_v = scenario.cell.gain_vs_per_m * (record.reference_m_s - record.speed_m_s)


def _check_apart(scenario: Scenario, record: Record) -> None:
    order = sorted(range(len(scenario.parcel)), key=lambda number: scenario.parcel[number].x_m)
    for left, right in pairwise(order):
        apart_m = (scenario.parcel[left].length_m + scenario.parcel[right].length_m) / 2
        gap_m = record.pose[:, right, 0] - record.pose[:, left, 0] - apart_m
        if (gap_m < 0.0).any():
            raise ScenarioError(
                f"parcels {scenario.parcel[left].name!r} and {scenario.parcel[right].name!r} touch "
                f"at {record.time_s[np.argmax(gap_m < 0.0)]:.3f} s, but on the row each must move "
                "alone; start them further apart or set run.fidelity to 'ideal'"
            )
