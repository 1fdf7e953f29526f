"""Each cell's own motor: what it is built of, and how its wheel answers to a held voltage."""

import math
from dataclasses import replace

import numpy as np

from mdms_sim.physics.compiled import compiled
from mdms_sim.record import Floats
from mdms_sim.scenario import Cell, Scenario

#: The random stream of motor spreads, apart from the other uses of the scenario's seed.
STREAM = 1
SPREAD = (
    "torque_constant_nm_per_a",
    "resistance_ohm",
    "damping_nms",
    "friction",
    "viscous_friction_s_per_m",
)


def build_cells(scenario: Scenario) -> list[Cell]:
    """Every cell with its own constants, off by up to `motor_spread` (relative, by seed)."""
    cell = scenario.cell
    count = scenario.array.columns * scenario.array.rows
    chance = np.random.default_rng([scenario.run.seed, STREAM])
    spreads = chance.uniform(-cell.motor_spread, cell.motor_spread, (count, len(SPREAD)))
    return [_spread(cell, own) for own in 1.0 + spreads]


def _spread(cell: Cell, factors: Floats) -> Cell:
    values = {
        name: getattr(cell, name) * float(factor)
        for name, factor in zip(SPREAD, factors, strict=True)
    }
    return replace(cell, **values)


@compiled
def applied_voltage(voltage_v: float, supply_v: float, pwm_steps: int) -> float:
    """What the bridge makes of a wanted voltage: within the supply, in whole PWM steps [V]."""
    duty = min(max(voltage_v / supply_v, -1.0), 1.0)
    return round(duty * pwm_steps) / pwm_steps * supply_v


@compiled
def coast(
    mass_kg: float, damping_n_s_per_m: float, step_s: float
) -> tuple[float, float, float, float]:
    """How m v' = F - k v answers over a step of constant F, exactly: (E, g, T, q) of

    v+ = E v + g F and travel = T v + q F. A massless wheel (m = 0) follows F / k at once.
    """
    if mass_kg <= 0.0:
        return 0.0, 1.0 / damping_n_s_per_m, 0.0, step_s / damping_n_s_per_m
    rate = damping_n_s_per_m * step_s / mass_kg
    if rate < 1e-4:  # the closed forms below would lose digits
        gain = step_s / mass_kg * (1.0 - rate / 2.0 + rate * rate / 6.0)
        travel = step_s * step_s / mass_kg * (0.5 - rate / 6.0 + rate * rate / 24.0)
    else:
        gain = -math.expm1(-rate) / damping_n_s_per_m
        travel = (step_s - gain * mass_kg) / damping_n_s_per_m
    return 1.0 - gain * damping_n_s_per_m, gain, gain * mass_kg, travel
