"""What the cells can sense: presence of a parcel over each sensor, and encoder counts."""

import math

import numpy as np
from numpy.typing import NDArray

from mdms_sim.physics.compiled import compiled
from mdms_sim.physics.parcel import cells_near, covers, place_of
from mdms_sim.physics.wheels import Grid, Records
from mdms_sim.record import Floats
from mdms_sim.scenario import Cell

COUNT_BITS = 31


def counts_per_m(cell: Cell) -> float:
    """Encoder counts per metre of a wheel's travel; the encoder sits on the motor's shaft."""
    turn_m = 2 * math.pi * cell.wheel_radius_m
    return cell.gear_ratio * cell.encoder_counts_per_motor_rev / turn_m


def encoder_counts(travel_m: Floats, counts_per_m: float) -> NDArray[np.int32]:
    """Counts passed, wrapping at 31 bits like the small integers of the firmware."""
    counts = np.floor(travel_m * counts_per_m).astype(np.int64)
    half = 1 << (COUNT_BITS - 1)
    return ((counts + half) % (1 << COUNT_BITS) - half).astype(np.int32)


@compiled
def presence_bits(
    grid: Grid, parcels: Records, edges: Floats, offset_m: Floats, bits: NDArray[np.uint8]
) -> None:
    """Set bit s of each cell's byte where a parcel lies over the sensor at offset s of the cell.

    `grid.reach_m` must cover the sensors' offsets (S, 2).
    """
    bits[:] = 0
    for p in range(parcels.size):
        body = parcels[p]
        place = place_of(body, (body.x_m, body.y_m, body.yaw_rad))
        left, right, low, high = cells_near(body, grid, place)
        for row in range(low, high):
            for column in range(left, right):
                x = (column - 0.5 * (grid.columns - 1)) * grid.pitch_m
                y = (row - 0.5 * (grid.rows - 1)) * grid.pitch_m
                for s in range(offset_m.shape[0]):
                    if covers(body, edges, place, x + offset_m[s, 0], y + offset_m[s, 1]):
                        bits[row * grid.columns + column] |= 1 << s
