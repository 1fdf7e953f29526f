"""What the cells can sense: a parcel over each presence sensor, encoder counts, wheel loads."""

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from mdms_model.array import Grid, reach_m
from mdms_model.arrays import Floats, Records
from mdms_model.compiled import compiled
from mdms_model.parcel import cells_near, covers, place_of
from mdms_model.scenario.scenario import Cell, Scenario
from mdms_sim.physics.plane.scene import Scene

COUNT_BITS = 31
#: Random streams, apart from the other uses of the scenario's seed.
PRESENCE_STREAM, LOAD_STREAM = 2, 3
#: Two readings at the same time differ by rounding only [s].
ROUNDING_S = 1e-9

Bits = NDArray[np.uint8]


def counts_per_m(cell: Cell) -> float:
    """Encoder counts per metre of a wheel's travel; the encoder sits on the motor's shaft."""
    turn_m = 2 * math.pi * cell.wheel_radius_m
    return cell.gear_ratio * cell.encoder_counts_per_motor_rev / turn_m


@compiled
def encoder_count(travel_m: float, counts_per_m: float) -> int:
    """Counts passed, wrapping at 31 bits like the small integers of the firmware."""
    half = 1 << (COUNT_BITS - 1)
    return (math.floor(travel_m * counts_per_m) + half) % (1 << COUNT_BITS) - half


class PresenceSensors:
    """Binary sensors under the table's surface, late and at times wrong, as the scenario says."""

    def __init__(self, scenario: Scenario) -> None:
        array, cell = scenario.array, scenario.cell
        self._offset_m = np.array(cell.sensor_offset_m, dtype=np.float64)
        self._grid = Grid(array.columns, array.rows, array.pitch_m, reach_m(cell.sensor_offset_m))
        self._delay_s = cell.sensor_delay_s
        self._noise = cell.sensor_noise
        self._chance = np.random.default_rng([scenario.run.seed, PRESENCE_STREAM])
        self._seen: deque[tuple[float, Bits]] = deque()

    def read(self, scene: Scene, now_s: float) -> Bits:
        """One byte a cell, bit s for the sensor at `cell.sensor_offset_m[s]`, as sensed by now.

        A reading is the newest that is as old as the delay; before that, the first one.
        """
        bits = np.zeros(self._grid.columns * self._grid.rows, dtype=np.uint8)
        presence_bits(self._grid, scene.parcels, scene.edges, self._offset_m, bits)
        return self._disturb(self._late(bits, now_s))

    def _late(self, bits: Bits, now_s: float) -> Bits:
        if self._delay_s == 0.0:
            return bits
        self._seen.append((now_s, bits))
        while len(self._seen) > 1 and self._seen[1][0] <= now_s - self._delay_s + ROUNDING_S:
            self._seen.popleft()
        return self._seen[0][1]

    def _disturb(self, bits: Bits) -> Bits:
        if self._noise == 0.0:
            return bits
        wrong = self._chance.random((len(bits), len(self._offset_m))) < self._noise
        return bits ^ (wrong @ (1 << np.arange(len(self._offset_m)))).astype(np.uint8)


class LoadCells:
    """One load cell under each wheel, with noise of a normal distribution."""

    def __init__(self, scenario: Scenario, noise_n: float) -> None:
        self._noise_n = noise_n
        self._chance = np.random.default_rng([scenario.run.seed, LOAD_STREAM])

    def read(self, normal_n: Floats) -> Floats:
        """What the load cells tell of these normal forces (W,) [N]."""
        return normal_n + self._chance.normal(0.0, self._noise_n, normal_n.shape)


@compiled
def presence_bits(
    grid: Grid, parcels: Records, edges: Floats, offset_m: Floats, bits: Bits
) -> None:
    """Set bit s of each cell's byte where a parcel lies over the sensor at offset s of the cell.

    `grid.reach_m` must cover the sensors' offsets (S, 2).
    """
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
