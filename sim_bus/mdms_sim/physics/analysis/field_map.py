"""What a field does to a parcel wherever it is put: forces over places, torque over yaws.

The parcel is held still while the wheels run, so that the map shows the field alone. The fields of
Boehringer, Donald and MacDonald (squeeze, ICRA 1994) and Kavraki (elliptic, ICRA 1997) can be seen
here on wheels that are few and stand apart, and what wheels beside their cells' centres do to them.
"""

import math
from dataclasses import dataclass

import numpy as np

from mdms_model.arrays import Floats
from mdms_model.parcel import held_parcel
from mdms_model.scenario.scenario import Array, Parcel, Scenario
from mdms_sim.physics.analysis.equilibria import Kind, PlaceRest, TurnRest, place_rests, turn_rests
from mdms_sim.physics.analysis.held_parcel import Law, forces_at, held_force, settle, table_of

POINTS_PER_PITCH = 24
MOST_POINTS = 241
YAWS = 361
NOTHING = 1e-9
"""A torque below this share of weight times length is none."""


@dataclass(frozen=True, slots=True)
class FieldMap:
    """Forces on a parcel over places of its centre at its yaw, and its torque over yaws.

    `force_n` (ny, nx, 2) [N] and `torque_nm` (ny, nx) [N m; about the centre of mass] are NaN
    where the parcel tips; on one row of cells ny is 1. At each of `yaw_rad`, over a whole turn,
    the parcel is at `settled_m` (nyaw, 2): where the field holds it, or where the scenario puts it
    if the field holds it nowhere.
    """

    law: Law
    x_m: Floats
    y_m: Floats
    force_n: Floats
    torque_nm: Floats
    places: tuple[PlaceRest, ...]
    yaw_rad: Floats
    settled_m: Floats
    turning_nm: Floats
    turns: tuple[TurnRest, ...]


def map_field(
    scenario: Scenario, parcel: Parcel, reference_m_s: Floats, law: Law = Law.SLIDING
) -> FieldMap:
    """Put a parcel everywhere on the array, under references of shape (W,)."""
    table, held = table_of(scenario, reference_m_s, law), held_parcel(scenario, parcel)
    x_m, y_m = _places(scenario.array, parcel)

    def forces(xs_m: Floats, ys_m: Floats) -> Floats:
        return forces_at(table, held, xs_m, ys_m, parcel.yaw_rad)[..., :2]

    found = forces_at(table, held, x_m, y_m, parcel.yaw_rad)
    places = place_rests(x_m, y_m, found[..., :2], forces)
    yaw_rad = np.linspace(-math.pi, math.pi, YAWS)
    settled_m = np.tile([parcel.x_m, parcel.y_m], (YAWS, 1))
    if (start_m := _start(parcel, places)) is not None:
        step_m = scenario.array.pitch_m / 4
        settled_m = np.array([settle(table, held, start_m, yaw, step_m) for yaw in yaw_rad])
    poses = np.column_stack([settled_m, yaw_rad])
    turning_nm = np.array([held_force(table, held, *pose)[2] for pose in poses])
    nothing_nm = NOTHING * held.weight_n * parcel.length_m
    return FieldMap(
        law=law,
        x_m=x_m,
        y_m=y_m,
        force_n=found[..., :2],
        torque_nm=found[..., 2],
        places=tuple(places),
        yaw_rad=yaw_rad,
        settled_m=settled_m,
        turning_nm=turning_nm,
        turns=tuple(turn_rests(yaw_rad, turning_nm, nothing_nm)),
    )


def _places(array: Array, parcel: Parcel) -> tuple[Floats, Floats]:
    """Places over the whole table, alike on both sides of its middle."""
    x_m = _axis(array.columns, array.pitch_m)
    return x_m, _axis(array.rows, array.pitch_m) if array.rows > 1 else np.array([parcel.y_m])


def _axis(cells: int, pitch_m: float) -> Floats:
    points = min(cells * POINTS_PER_PITCH, MOST_POINTS - 1) + 1
    return np.linspace(-cells * pitch_m / 2, cells * pitch_m / 2, points)


def _start(parcel: Parcel, places: list[PlaceRest]) -> Floats | None:
    """The equilibrium nearest to the parcel's place that draws it in; None where there is none."""
    here = np.array([parcel.x_m, parcel.y_m])
    drawn = [
        np.array([rest.x_m, rest.y_m])
        for rest in places
        if rest.kind in (Kind.STABLE, Kind.SPIRAL, Kind.NEUTRAL)
    ]
    return min(drawn, key=lambda place: float(np.hypot(*(place - here))), default=None)
