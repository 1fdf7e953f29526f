"""A step under the voltages of cells, and what their encoders and current sensors tell after it."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdms_model.compiled import compiled
from mdms_sim.physics.plane.scene import Scene
from mdms_sim.physics.plane.sensors import encoder_count
from mdms_sim.physics.plane.step import step_voltage

UV_PER_V = 1e6
MA_PER_A = 1e3

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
            sampled.counts[cell, axis] = encoder_count(wheel.travel_m, sampled.counts_per_m)
            sampled.current_ma[cell, axis] = int(wheel.current_a * MA_PER_A)
    return news
