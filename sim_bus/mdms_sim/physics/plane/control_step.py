"""A step under the voltages of cells, and what their encoders and current sensors read after it."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdms_model.arrays import Floats
from mdms_model.compiled import compiled
from mdms_sim.physics.plane.records import Scene
from mdms_sim.physics.plane.sensors import encoder_count
from mdms_sim.physics.plane.step import step_voltage

UV_PER_V = 1e6
#: Below this supply a bridge shuts off (DRV8874: undervoltage lockout).
BRIDGE_SUPPLY_MIN_V = 4.5
#: What the firmware takes a bridge's own fault for: a current over any limit that is watched.
SHUT_OFF_MA = 6000
MA_PER_A = 1e3

Registers = NDArray[np.int32]


class Sampled(NamedTuple):
    """What cells have sampled, of shape (cells, 2); 0 where a cell has no such wheel."""

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
    """Move on under voltages (cells, 2) held over the step; returns what there is to report."""
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
