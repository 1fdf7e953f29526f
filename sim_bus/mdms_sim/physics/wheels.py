"""All wheels of the array: where they stand, along what they push, and what drives them."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdms_sim.physics.drive import drive_of
from mdms_sim.physics.motor import build_cells
from mdms_sim.record import Floats
from mdms_sim.scenario import Array, Cell, Scenario

Records = Any  # arrays of the record types below; their fields are read by name in the kernels

#: One wheel in the compiled kernels: its constants, then its state.
WHEEL = np.dtype(
    [
        ("x_m", "f8"),
        ("y_m", "f8"),
        ("direction_x", "f8"),
        ("direction_y", "f8"),
        ("a", "f8"),  # N s/m, eq (9)
        ("b", "f8"),  # N s/m, eq (9)
        ("force_per_volt", "f8"),  # Ke/Rm, eq (8) [N/V]
        ("loss", "f8"),  # Be + Ke^2/Rm, eq (8) [N s/m]
        ("mass_kg", "f8"),  # the rotor's inertia, felt at the rim
        ("friction", "f8"),
        ("viscous_s_per_m", "f8"),
        ("supply_v", "f8"),
        ("pwm_steps", "i8"),
        ("speed_m_s", "f8"),
        ("travel_m", "f8"),
        ("normal_n", "f8"),
        ("force_n", "f8"),
        ("contact", "i8"),
    ],
    align=True,
)


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
    centres = cell_centres(scenario.array)
    wheel = scenario.cell.wheel
    cell = np.repeat(np.arange(len(centres)), len(wheel))
    offset = np.array([w.offset_m for w in wheel], dtype=np.float64)
    angle = np.array([w.direction_rad for w in wheel], dtype=np.float64)
    direction = np.column_stack([_exact_cos(angle), _exact_cos(angle - np.pi / 2)])
    return Wheels(
        position_m=centres[cell] + np.tile(offset, (len(centres), 1)),
        direction=np.tile(direction, (len(centres), 1)),
        cell=cell,
        first=np.arange(len(centres) + 1) * len(wheel),
    )


def wheel_records(scenario: Scenario, wheels: Wheels) -> Records:
    """The wheels as the kernels take them: records of type WHEEL, at rest."""
    cells = build_cells(scenario)
    records = np.zeros(len(wheels.cell), dtype=WHEEL)
    records["x_m"], records["y_m"] = wheels.position_m.T
    records["direction_x"], records["direction_y"] = wheels.direction.T
    for record, cell in zip(records, wheels.cell, strict=True):
        _fit_motor(record, cells[cell])
    return records


def _fit_motor(record: Records, cell: Cell) -> None:
    drive = drive_of(cell)
    gear_per_m = cell.gear_ratio / cell.wheel_radius_m
    record["a"], record["b"] = drive.a, drive.b
    record["force_per_volt"] = drive.ke / cell.resistance_ohm
    record["loss"] = drive.be + drive.ke**2 / cell.resistance_ohm
    record["mass_kg"] = cell.rotor_inertia_kg_m2 * gear_per_m**2
    record["friction"] = cell.friction
    record["viscous_s_per_m"] = cell.viscous_friction_s_per_m
    record["supply_v"], record["pwm_steps"] = cell.supply_v, cell.pwm_steps


def _exact_cos(angle_rad: Floats) -> Floats:
    """Cosine that is exactly zero at right angles, so that wheels along y do not push along x."""
    cosine = np.cos(angle_rad)
    return np.where(np.abs(cosine) < 1e-15, 0.0, cosine)
