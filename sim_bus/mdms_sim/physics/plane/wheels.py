"""Wheels as the compiled steps take them: their places, constants and states, as records."""

from collections.abc import Sequence

import numpy as np

from mdms_model.array import Wheels
from mdms_model.arrays import Records
from mdms_model.motor import drive_of
from mdms_model.scenario.scenario import Cell

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
        ("coasting", "i8"),  # 1: its bridge leaves the motor open
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


def wheel_records(wheels: Wheels, cells: Sequence[Cell]) -> Records:
    """The wheels as the kernels take them: records of type WHEEL, at rest."""
    records = np.zeros(len(wheels.cell), dtype=WHEEL)
    records["x_m"], records["y_m"] = wheels.position_m.T
    records["direction_x"], records["direction_y"] = wheels.direction.T
    records["parcel"] = NOBODY
    for number, cell in enumerate(cells):
        _fit(records[wheels.first[number] : wheels.first[number + 1]], cell)
    return records


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
