"""What running wheels do to a parcel that is held still: net force and torque, pose by pose."""

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from mdms_model.array import build_wheels
from mdms_model.arrays import Floats
from mdms_model.compiled import compiled
from mdms_model.motor import drive_of
from mdms_model.parcel import HeldParcel, covers, place_of, turned
from mdms_model.scenario.scenario import Scenario
from mdms_model.statics.supports import press
from mdms_sim.physics.motor import true_cells


class Law(IntEnum):
    """How the wheels push."""

    SLIDING = 0
    """All slip: mu N the way they turn (eq 4); with viscous friction mu_v N times their speed."""
    AT_REST = 1
    """The motors' force on what does not move, as far as friction carries it (eqs 9 and 12)."""


class Table(NamedTuple):
    """All wheels of an array that runs, (W, 2) and (W,)."""

    position_m: Floats
    direction: Floats
    push_n: Floats
    """a r, the force at which a wheel stalls."""
    drag: Floats
    """b."""
    friction: Floats
    viscous_s_per_m: Floats
    law: int


def table_of(scenario: Scenario, reference_m_s: Floats, law: Law) -> Table:
    """The array under references of shape (W,)."""
    wheels = build_wheels(scenario)
    cells = true_cells(scenario)
    drives = [drive_of(cells[cell]) for cell in wheels.cell]
    return Table(
        wheels.position_m,
        wheels.direction,
        np.array([drive.a for drive in drives]) * reference_m_s,
        np.array([drive.b for drive in drives]),
        np.array([cells[cell].friction for cell in wheels.cell]),
        np.array([cells[cell].viscous_friction_s_per_m for cell in wheels.cell]),
        int(law),
    )


@compiled
def wheel_push_n(table: Table, i: int, normal_n: float) -> float:
    """Force of wheel `i` along its direction on what does not move."""
    stall_n: float = table.push_n[i]
    limit_n: float = table.friction[i] * normal_n
    grip: float = table.viscous_s_per_m[i] * normal_n
    drag: float = table.drag[i]
    if grip > 0.0:
        return stall_n * grip / (drag + grip if table.law == Law.AT_REST else drag)
    if table.law == Law.SLIDING and stall_n != 0.0:
        return math.copysign(limit_n, stall_n)
    return min(max(stall_n, -limit_n), limit_n)


@compiled
def held_force(
    table: Table, held: HeldParcel, x_m: float, y_m: float, yaw_rad: float
) -> tuple[float, float, float]:
    """Net force [N] and torque about the centre of mass [N m]; NaN where the parcel tips.

    `x_m`, `y_m` is the parcel's geometric centre.
    """
    arm_x, arm_y = turned(held.body.centre_x_m, held.body.centre_y_m, yaw_rad)
    com_x, com_y = x_m + arm_x, y_m + arm_y
    place = place_of(held.body, (com_x, com_y, yaw_rad))
    wheels = len(table.push_n)
    under, spot_m = np.empty(wheels, np.int64), np.empty((wheels, 2))
    count = 0
    for i in range(wheels):
        if covers(held.body, held.edges, place, table.position_m[i, 0], table.position_m[i, 1]):
            under[count] = i
            spot_m[count, 0] = table.position_m[i, 0] - com_x
            spot_m[count, 1] = table.position_m[i, 1] - com_y
            count += 1
    normal_n = np.empty(count)
    if not press(spot_m[:count], held.weight_n, normal_n):
        return math.nan, math.nan, math.nan
    force_x, force_y, torque = 0.0, 0.0, 0.0
    for j in range(count):
        i = under[j]
        push_n = wheel_push_n(table, i, normal_n[j])
        push_x, push_y = push_n * table.direction[i, 0], push_n * table.direction[i, 1]
        force_x += push_x
        force_y += push_y
        torque += spot_m[j, 0] * push_y - spot_m[j, 1] * push_x
    return force_x, force_y, torque


@compiled
def forces_at(table: Table, held: HeldParcel, x_m: Floats, y_m: Floats, yaw_rad: float) -> Floats:
    """`held_force` over a grid of places, (ny, nx, 3)."""
    found = np.empty((len(y_m), len(x_m), 3))
    for row in range(len(y_m)):
        for column in range(len(x_m)):
            found[row, column] = held_force(table, held, x_m[column], y_m[row], yaw_rad)
    return found


@compiled
def settle(table: Table, held: HeldParcel, start: Floats, yaw_rad: float, first_m: float) -> Floats:
    """Where a parcel creeps to along the force at one yaw, in steps that shrink from `first_m`."""
    x_m, y_m, step_m = start[0], start[1], first_m
    while step_m > 1e-6 * first_m:
        force_x, force_y, _ = held_force(table, held, x_m, y_m, yaw_rad)
        if math.isnan(force_x):
            break
        pull = math.hypot(force_x, force_y) + 0.02 * held.weight_n
        x_m += step_m * force_x / pull
        y_m += step_m * force_y / pull
        step_m *= 0.95
    return np.array([x_m, y_m])
