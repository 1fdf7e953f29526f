"""Each cell's own motor: its parameters, and the answer of its wheel to a held voltage."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mdms_model.array import build_cells
from mdms_model.compiled import compiled
from mdms_model.scenario.scenario import Cell, Scenario

#: The random stream of the spreads, apart from the other uses of the scenario's seed.
STREAM = 1
MOTOR = ("torque_constant_nm_per_a", "resistance_ohm", "damping_nms")
FRICTION = ("friction", "viscous_friction_s_per_m")


def true_cells(scenario: Scenario) -> list[Cell]:
    """Every cell with its own constants, as nobody but the simulator has them.

    Each motor constant is off by up to `motor_spread`, friction by up to `friction_spread`
    (relative, even chances, by seed).
    """
    cells = build_cells(scenario)
    chance = np.random.default_rng([scenario.run.seed, STREAM])
    factors = chance.uniform(-1.0, 1.0, (len(cells), len(MOTOR) + 1)).tolist()
    return [_spread(cell, own) for cell, own in zip(cells, factors, strict=True)]


def _spread(cell: Cell, off: Sequence[float]) -> Cell:
    """One cell, each constant off by its share of the spread."""
    shares = {name: cell.motor_spread * own for name, own in zip(MOTOR, off, strict=False)}
    shares |= dict.fromkeys(FRICTION, cell.friction_spread * off[-1])
    values = {name: getattr(cell, name) * (1.0 + share) for name, share in shares.items()}
    return replace(cell, **values)


@compiled
def applied_voltage(voltage_v: float, supply_v: float, pwm_steps: int) -> float:
    """The bridge's voltage for a wanted one: within the supply, in whole PWM steps [V]."""
    if supply_v <= 0.0:
        return 0.0
    duty = min(max(voltage_v / supply_v, -1.0), 1.0)
    return round(duty * pwm_steps) / pwm_steps * supply_v


@compiled
def coast(
    mass_kg: float, loss_n_s_per_m: float, step_s: float
) -> tuple[float, float, float, float]:
    """How m v' = F - k v answers over a step of constant F, exactly: (E, g, T, q) of

    v+ = E v + g F and travel = T v + q F. A massless wheel (m = 0) follows F / k at once.
    """
    if mass_kg <= 0.0:
        return 0.0, 1.0 / loss_n_s_per_m, 0.0, step_s / loss_n_s_per_m
    rate = loss_n_s_per_m * step_s / mass_kg
    if rate < 1e-4:  # the closed forms below would lose digits
        gain = step_s / mass_kg * (1.0 - rate / 2.0 + rate * rate / 6.0)
        stride = step_s * step_s / mass_kg * (0.5 - rate / 6.0 + rate * rate / 24.0)
    else:
        gain = -math.expm1(-rate) / loss_n_s_per_m
        stride = (step_s - gain * mass_kg) / loss_n_s_per_m
    return 1.0 - gain * loss_n_s_per_m, gain, gain * mass_kg, stride
