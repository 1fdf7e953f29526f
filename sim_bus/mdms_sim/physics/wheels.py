"""All wheels of the array: where they stand, along what they push, and what drives them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdms_sim.physics.drive import drive_of
from mdms_sim.physics.motor import build_cells
from mdms_sim.record import Floats
from mdms_sim.scenario import Array, Cell, Scenario

Records = Any  # arrays of the record types below; their fields are read by name in the kernels

#: One wheel in the compiled kernels: its place, its constants, its state.
WHEEL = np.dtype(
    [
        ("x_m", "f8"),
        ("y_m", "f8"),
        ("direction_x", "f8"),
        ("direction_y", "f8"),
        ("friction", "f8"),
        ("viscous_s_per_m", "f8"),
        ("roller_friction", "f8"),
        ("a", "f8"),  # N s/m, eq (9)
        ("b", "f8"),  # N s/m, eq (9)
        ("parcel", "i8"),  # which lies on it; NOBODY if none
        ("contact", "i8"),
        ("normal_n", "f8"),
        ("force_n", "f8"),
        ("slip_m_s", "f8"),
        ("speed_m_s", "f8"),
        ("travel_m", "f8"),
        ("current_a", "f8"),  # of the motor, under voltage only
        # Only wheels under voltage need the rest.
        ("force_per_volt", "f8"),  # Ke/Rm, eq (8) [N/V]
        ("force_per_ampere", "f8"),  # Ke [N/A]
        ("loss", "f8"),  # Be + Ke^2/Rm, eq (8) [N s/m]
        ("damping", "f8"),  # Be [N s/m]
        ("force_limit_n", "f8"),  # Ke times the current limit
        ("mass_kg", "f8"),  # inertia of rotor and wheel, felt at the rim
        ("supply_v", "f8"),
        ("pwm_steps", "i8"),
        # This step: v+ = decay v + gain F, travel = glide v + stride F, F = drive - push.
        ("drive_n", "f8"),
        ("braking", "f8"),  # of the back-EMF [N s/m]; 0 while the current is limited
        ("decay", "f8"),
        ("gain", "f8"),
        ("glide", "f8"),
        ("stride", "f8"),
    ],
    align=True,
)
NOBODY = -1


class Grid(NamedTuple):
    """The regular grid of cells, for finding the cells near a place without a search."""

    columns: int
    rows: int
    pitch_m: float
    reach_m: float
    """Farthest that a point of a cell lies from its centre along x or y."""


@dataclass(frozen=True, slots=True)
class Wheels:
    """Positions (W, 2) [m; table frame], unit directions (W, 2) and cells (W,), 0-based.

    Ordered by cell, then axis; cells along x first. Cell c has the wheels first[c] to
    first[c + 1] - 1.
    """

    position_m: Floats
    direction: Floats
    cell: NDArray[np.int64]
    first: NDArray[np.int64]


def cell_centres(array: Array) -> Floats:
    """Centres of the cells (cells, 2), along x first, about the array's centre [m]."""
    column = np.arange(array.columns) - (array.columns - 1) / 2
    row = np.arange(array.rows) - (array.rows - 1) / 2
    y, x = np.meshgrid(row, column, indexing="ij")
    return np.column_stack([x.ravel(), y.ravel()]) * array.pitch_m


def build_wheels(scenario: Scenario) -> Wheels:
    """Lay out the wheels of every cell of a scenario."""
    return lay_out(cell_centres(scenario.array), build_cells(scenario))


def lay_out(centres_m: Floats, cells: Sequence[Cell]) -> Wheels:
    """Lay out the wheels of these cells at these centres (cells, 2)."""
    counts = [len(cell.wheel) for cell in cells]
    cell = np.repeat(np.arange(len(cells)), counts)
    wheels = [wheel for own in cells for wheel in own.wheel]
    offset = np.array([wheel.offset_m for wheel in wheels], dtype=np.float64)
    angle = np.array([wheel.direction_rad for wheel in wheels], dtype=np.float64)
    return Wheels(
        position_m=centres_m[cell] + offset,
        direction=np.column_stack([_exact_cos(angle), _exact_cos(angle - np.pi / 2)]),
        cell=cell,
        first=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
    )


def wheel_records(wheels: Wheels, cells: Sequence[Cell]) -> Records:
    """The wheels as the kernels take them: records of type WHEEL, at rest."""
    records = np.zeros(len(wheels.cell), dtype=WHEEL)
    records["x_m"], records["y_m"] = wheels.position_m.T
    records["direction_x"], records["direction_y"] = wheels.direction.T
    records["parcel"] = NOBODY
    for number, cell in enumerate(cells):
        _fit(records[wheels.first[number] : wheels.first[number + 1]], cell)
    return records


def reach_m(offsets_m: Sequence[tuple[float, float]]) -> float:
    """How far these points of a cell lie from its centre at most, along x or y."""
    return max((max(abs(x), abs(y)) for x, y in offsets_m), default=0.0)


def _fit(records: Records, cell: Cell) -> None:
    """Give all wheels of a cell its motor and surface."""
    drive = drive_of(cell)
    gear_per_m = cell.gear_ratio / cell.wheel_radius_m
    limit_a = np.inf if cell.current_limit_a is None else cell.current_limit_a
    records["friction"] = cell.friction
    records["viscous_s_per_m"] = cell.viscous_friction_s_per_m
    records["roller_friction"] = cell.roller_friction
    records["a"], records["b"] = drive.a, drive.b
    records["force_per_volt"] = drive.ke / cell.resistance_ohm
    records["force_per_ampere"] = drive.ke
    records["loss"] = drive.be + drive.ke**2 / cell.resistance_ohm
    records["damping"] = drive.be
    records["force_limit_n"] = drive.ke * limit_a
    records["mass_kg"] = (
        cell.rotor_inertia_kg_m2 * gear_per_m**2 + cell.wheel_inertia_kg_m2 / cell.wheel_radius_m**2
    )
    records["supply_v"], records["pwm_steps"] = cell.supply_v, cell.pwm_steps


def _exact_cos(angle_rad: Floats) -> Floats:
    """Cosine that is exactly zero at right angles, so that wheels along y do not push along x."""
    cosine = np.cos(angle_rad)
    return np.where(np.abs(cosine) < 1e-15, 0.0, cosine)
