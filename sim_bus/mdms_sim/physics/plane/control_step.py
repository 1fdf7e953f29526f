"""A step under the voltages of cells, and what their sensors read after it.

Cells sense a parcel over each presence sensor, encoder counts, and the loads of wheels.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdms_model.array import Grid, reach_m
from mdms_model.arrays import Bits, Floats, Ints, Records
from mdms_model.compiled import compiled, for_types_of
from mdms_model.parcel import cells_near, covers, place_of
from mdms_model.scenario.scenario import Cell, Scenario
from mdms_sim.physics.plane.records import Scene
from mdms_sim.physics.plane.step import step_voltage

COUNT_BITS = 31
#: Random streams, apart from the other uses of the scenario's seed.
PRESENCE_STREAM, LOAD_STREAM = 2, 3
#: Two readings at the same time differ by rounding only [s].
ROUNDING_S = 1e-9


@dataclass(frozen=True, slots=True)
class SenseState:
    """The state that the sensors go on from:

    their random numbers, and readings that are still to come.
    """

    chance: Mapping[str, Any]
    seen: tuple[tuple[float, Bits], ...] = ()


def counts_per_m(cell: Cell) -> float:
    """Encoder counts per metre of a wheel's travel; the encoder sits on the motor's shaft."""
    turn_m = 2 * math.pi * cell.wheel_radius_m
    return cell.gear_ratio * cell.encoder_counts_per_motor_rev / turn_m


@compiled
def encoder_count(travel_m: float, counts_per_m: float) -> int:
    """Counts passed, wrapping at 31 bits like the small integers of the firmware."""
    half = 1 << (COUNT_BITS - 1)
    return (math.floor(travel_m * counts_per_m) + half) % (1 << COUNT_BITS) - half


class SensorPlaces(NamedTuple):
    """Where each cell has its sensors: offsets (S, 2) from its centre, which `grid` reaches to."""

    grid: Grid
    offset_m: Floats


class PresenceSensors:
    """Binary sensors under the table's surface, late and at times wrong, as the scenario says.

    A sensor that is stuck both ways reads covered.
    """

    def __init__(self, scenario: Scenario) -> None:
        array, cell = scenario.array, scenario.cell
        self._places = SensorPlaces(
            Grid(array.columns, array.rows, array.pitch_m, reach_m(cell.sensor_offset_m)),
            np.array(cell.sensor_offset_m, dtype=np.float64),
        )
        self._delay_s = cell.sensor_delay_s
        self._noise = cell.sensor_noise
        self._chance = np.random.default_rng([scenario.run.seed, PRESENCE_STREAM])
        self._seen: deque[tuple[float, Bits]] = deque()
        self._find_bits: Callable[..., None] | None = None
        #: How many faults hold each sensor, as free and as covered, (2, cells, S).
        self.stuck: Ints = np.zeros(
            (2, array.columns * array.rows, len(cell.sensor_offset_m)), np.int64
        )

    def read(self, scene: Scene, now_s: float) -> Bits:
        """One byte a cell, bit s for the sensor at `cell.sensor_offset_m[s]`, as sensed by now.

        A reading is the newest that is as old as the delay; before that, the first one.
        """
        bits = np.zeros(self._places.grid.columns * self._places.grid.rows, dtype=np.uint8)
        arguments = self._places, scene.model.parcels, scene.state.parcels, scene.model.edges, bits
        if self._find_bits is None:
            # Sorting out the types of its arguments would take longer than the function itself.
            self._find_bits = for_types_of(presence_bits, *arguments)
        self._find_bits(*arguments)
        # A fault is at the sensor's output, behind its delay and its noise.
        return self.misread(self._late(bits, now_s))

    def misread(self, bits: Bits) -> Bits:
        """The bits as sensors with noise and faults show them."""
        return self._hold(self._disturb(bits))

    def state(self) -> SenseState:
        """The state that the next readings depend on."""
        return SenseState(self._chance.bit_generator.state, tuple(self._seen))

    def restore(self, state: SenseState) -> None:
        """Go on from there."""
        self._chance.bit_generator.state = state.chance
        self._seen = deque(state.seen)

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
        wrong = self._chance.random((len(bits), len(self._places.offset_m))) < self._noise
        return bits ^ (wrong @ (1 << np.arange(len(self._places.offset_m)))).astype(np.uint8)

    def _hold(self, bits: Bits) -> Bits:
        # `any` takes four times as long.
        if not np.count_nonzero(self.stuck):
            return bits
        values = 1 << np.arange(len(self._places.offset_m))
        free, covered = ((self.stuck > 0) @ values).astype(np.uint8)
        held: Bits = bits & ~free | covered
        return held


class LoadCells:
    """One load cell under each wheel, with noise of a normal distribution."""

    def __init__(self, scenario: Scenario, noise_n: float) -> None:
        self._noise_n = noise_n
        self._chance = np.random.default_rng([scenario.run.seed, LOAD_STREAM])

    def read(self, normal_n: Floats) -> Floats:
        """The readings of the load cells under these normal forces (W,) [N]."""
        return normal_n + self._chance.normal(0.0, self._noise_n, normal_n.shape)

    def state(self) -> SenseState:
        """The state that the next readings depend on."""
        return SenseState(self._chance.bit_generator.state)

    def restore(self, state: SenseState) -> None:
        """Go on from there."""
        self._chance.bit_generator.state = state.chance


@compiled
def presence_bits(
    places: SensorPlaces, parcels: Records, states: Records, edges: Floats, bits: Bits
) -> None:
    """Set bit s of each cell's byte where a parcel lies over sensor s of the cell."""
    grid, offset_m = places
    for p in range(parcels.size):
        body, now = parcels[p], states[p]
        if now.lifted:
            continue
        place = place_of(body, (now.x_m, now.y_m, now.yaw_rad))
        left, right, low, high = cells_near(body, grid, place)
        for row in range(low, high):
            for column in range(left, right):
                x = (column - 0.5 * (grid.columns - 1)) * grid.pitch_m
                y = (row - 0.5 * (grid.rows - 1)) * grid.pitch_m
                for s in range(offset_m.shape[0]):
                    if covers(body, edges, place, x + offset_m[s, 0], y + offset_m[s, 1]):
                        bits[row * grid.columns + column] |= 1 << s


UV_PER_V = 1e6
#: Below this supply a bridge shuts off (DRV8874: undervoltage lockout).
BRIDGE_SUPPLY_MIN_V = 4.5
#: What the firmware takes a bridge's own fault for: a current over any limit that is watched.
SHUT_OFF_MA = 2_000_000
MA_PER_A = 1e3

Registers = NDArray[np.int32]


class Sampled(NamedTuple):
    """The samples of cells, of shape (cells, 2); 0 where a cell has no such wheel."""

    counts_per_m: float
    counts: Registers
    current_ma: Registers


class Bridges(NamedTuple):
    """The state of each cell's bridges, of shape (cells,).

    Contacts of the emergency stop come first: they cut a motor off its bridge, and short it. A
    motor is driven, or shorted at 0 V, by a bridge that is awake, has a supply, and has not shut
    off by a fault of its own; any other leaves it open, and the wheel coasts. The same table stands
    in docs/faults.md, 'Fail safe'.
    """

    awake: Registers
    shut_off: Registers
    supply_v: Floats
    shorted: Registers


@compiled
def step_cells(
    scene: Scene, voltage_uv: Registers, bridges: Bridges, step_s: float, sampled: Sampled
) -> int:
    """Move on under voltages (cells, 2) held over the step; returns the events to report."""
    first, wheels = scene.model.first, scene.state.wheels
    voltage_v = np.empty(wheels.size)
    for cell in range(first.size - 1):
        supplied = bridges.supply_v[cell] >= BRIDGE_SUPPLY_MIN_V
        closed = supplied and bridges.awake[cell] != 0 and bridges.shut_off[cell] == 0
        shorted = bridges.shorted[cell] != 0
        for w in range(first[cell], first[cell + 1]):
            wheel = wheels[w]
            volts = voltage_uv[cell, w - first[cell]] / UV_PER_V
            if shorted:
                volts = 0.0
            voltage_v[w] = -volts if wheel.reversed else volts
            wheel.supply_v = bridges.supply_v[cell]
            wheel.coasting = 0 if closed or shorted else 1
            if wheel.encoder_stuck:
                wheel.missed_m -= wheel.travel_m
    report = step_voltage(scene, voltage_v, step_s)
    for cell in range(first.size - 1):
        for w in range(first[cell], first[cell + 1]):
            wheel, axis = wheels[w], w - first[cell]
            if wheel.encoder_stuck:
                wheel.missed_m += wheel.travel_m
            else:
                counted_m = wheel.travel_m - wheel.missed_m
                sampled.counts[cell, axis] = encoder_count(counted_m, sampled.counts_per_m)
            # The bridge measures, and a motor of swapped leads sits the other way round behind it.
            current_ma = int(wheel.current_a * MA_PER_A)
            if wheel.reversed:
                current_ma = -current_ma
            if bridges.shorted[cell]:
                current_ma = 0
            sampled.current_ma[cell, axis] = SHUT_OFF_MA if bridges.shut_off[cell] else current_ma
    return report
