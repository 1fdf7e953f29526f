"""A step under the voltages of cells, and what their encoders and current sensors tell after it."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdms_sim.physics.compiled import compiled
from mdms_sim.physics.plane import step_voltage
from mdms_sim.physics.scene import Scene

UV_PER_V = 1e6
MA_PER_A = 1e3
#: Encoder counts wrap at 31 bits, as the small integers of the firmware do.
COUNTS = 1 << 31

Registers = NDArray[np.int32]


class Sampled(NamedTuple):
    """What cells have sampled, of shape (cells, 2); 0 where a cell has no such wheel."""

    counts_per_m: float
    counts: Registers
    current_ma: Registers


@compiled
def step_cells(scene: Scene, voltage_uv: Registers, step_s: float, sampled: Sampled) -> int:
    """Move on under voltages (cells, 2) held over the step; returns what there is to tell."""
    voltage_v = np.empty(scene.wheels.size)
    for cell in range(scene.first.size - 1):
        for w in range(scene.first[cell], scene.first[cell + 1]):
            voltage_v[w] = voltage_uv[cell, w - scene.first[cell]] / UV_PER_V
    news = step_voltage(scene, voltage_v, step_s)
    for cell in range(scene.first.size - 1):
        for w in range(scene.first[cell], scene.first[cell + 1]):
            wheel, axis = scene.wheels[w], w - scene.first[cell]
            count = math.floor(wheel.travel_m * sampled.counts_per_m)
            sampled.counts[cell, axis] = (count + COUNTS // 2) % COUNTS - COUNTS // 2
            sampled.current_ma[cell, axis] = int(wheel.current_a * MA_PER_A)
    return news
