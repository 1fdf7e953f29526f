"""One parcel's way along the row: its phases, and the events between them."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mdms_sim.physics.drive import drive_of
from mdms_sim.physics.row_events import HELD, REVERSAL, TIP
from mdms_sim.physics.row_parcel import ABSENT, BACKWARD, FORWARD, ROLLING, RowParcel
from mdms_sim.physics.row_supports import stretches_of
from mdms_sim.physics.row_trace import Trace, trace
from mdms_sim.record import Event, Floats
from mdms_sim.scenario import Parcel, Scenario

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
    """Trace one parcel from rest over the scenario's duration; as if it were alone."""
    row = row_parcel(scenario, parcel, reference_m_s)
    return Journey(parcel, row, trace(row, parcel.x_m, scenario.run.duration_s))


def row_parcel(scenario: Scenario, parcel: Parcel, reference_m_s: Floats) -> RowParcel:
    """The row as one parcel meets it; wheels beside the parcel do not count."""
    drive, com_m = drive_of(scenario.cell), parcel.centre_of_mass_m[0]
    wheel_x_m = wheel_places_m(scenario)
    beside = abs(scenario.cell.wheel[0].offset_m[1] - parcel.y_m) > parcel.width_m / 2
    stretches = stretches_of(wheel_x_m[:0] if beside else wheel_x_m, parcel.length_m, com_m)
    return RowParcel(
        edge_m=stretches.edge_m,
        first=stretches.first,
        last=stretches.last,
        wheel_x_m=wheel_x_m,
        push_n=drive.a * np.asarray(reference_m_s, dtype=np.float64),
        drag=drive.b,
        friction=scenario.cell.friction,
        weight_n=parcel.mass_kg * scenario.run.gravity_m_s2,
        mass_kg=parcel.mass_kg,
        com_m=com_m,
    )


def wheel_places_m(scenario: Scenario) -> Floats:
    """Contact points along the row, ascending [m; table frame]."""
    array = scenario.array
    first_m = -(array.columns - 1) / 2 * array.pitch_m + scenario.cell.wheel[0].offset_m[0]
    return first_m + array.pitch_m * np.arange(array.columns, dtype=np.float64)


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
