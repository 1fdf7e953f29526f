"""One parcel's way along the row: its phases, and the events between them."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mdms_model.array import build_wheels
from mdms_model.arrays import Floats
from mdms_model.motor import drive_of
from mdms_model.outline import chord_m
from mdms_model.run.record import Event
from mdms_model.scenario.scenario import Parcel, Scenario, ScenarioError
from mdms_model.statics.row_supports import stretches_of
from mdms_sim.physics.motor import true_cells
from mdms_sim.physics.row.events import HELD, REVERSAL, TIP
from mdms_sim.physics.row.parcel import ABSENT, BACKWARD, FORWARD, ROLLING, RowParcel
from mdms_sim.physics.row.trace import MOST_PHASES, Trace, trace

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
    """What happened on the way, in order of time."""
    for at in range(len(journey.trace.phases)):
        cause = journey.trace.whys[at, 0]
        if cause == REVERSAL:
            yield _event(journey, at, "reversal", f"turns at {journey.trace.phases[at, 1]:+.6f} m")
        elif cause == TIP:
            yield _event(journey, at, "tip", f"tips at {journey.trace.phases[at, 1]:+.6f} m")
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
