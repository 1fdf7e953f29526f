"""A DC motor with its wheel and encoder, exact over a tick of held voltage (paper, eq 8)."""

import math
from array import array
from dataclasses import dataclass

from mdms_cell import speed_loop as s
from mdms_cell import tuning

TICK_S = 0.001
COUNTS_PER_METRE = 37_596
PWM_STEPS = 1000


@dataclass(frozen=True)
class Motor:
    """The paper's motor at 4 ohm; a rotor of 5e-6 kg m2 behind 3:1 and a wheel of 25.4 mm."""

    force_per_ampere: float = 0.024 * 3 / 0.0254  # Ke [N/A]
    resistance_ohm: float = 4.0
    damping_n_s_per_m: float = 3.5e-6 * (3 / 0.0254) ** 2  # Be
    mass_kg: float = 5e-6 * (3 / 0.0254) ** 2

    @property
    def braking(self) -> float:
        """Be + Ke^2 / Rm [N s/m]."""
        return self.damping_n_s_per_m + self.force_per_ampere**2 / self.resistance_ohm

    def free_speed(self, reference_m_s: float, gain: float) -> float:
        """Where a free wheel settles under V = G (r - v) [m/s] (eq 9 at no force)."""
        pull = gain * self.force_per_ampere / self.resistance_ohm
        return reference_m_s * pull / (pull + self.braking)


def registers(gain_mv_s_m: int = 10_000, supply_mv: int = 24_000, lag_us: int = tuning.LAG_US):
    """The registers of a cell whose first axis runs."""
    made = array("i", [0] * s.REGISTERS)
    s.reset(made)
    made[s.AGE_LIMIT] = 1 << 29
    tuning.set_encoder(made, 0, COUNTS_PER_METRE, lag_us)
    tuning.set_law(made, 0, gain_mv_s_m, supply_mv)
    made[s.MODE] = s.RUN
    return made


def run(made, motor: Motor, supply_v: float, ticks: int) -> list[float]:
    """The wheel's speed [m/s] at the end of every tick, from rest."""
    decay = math.exp(-motor.braking / motor.mass_kg * TICK_S)
    lasting = (1 - decay) * motor.mass_kg / motor.braking
    speed = position = 0.0
    speeds = []
    for _ in range(ticks):
        made[s.COUNT] = math.floor(position * COUNTS_PER_METRE)
        s.step(made)
        duty = round(made[s.VOLTAGE] * 1e-6 / supply_v * PWM_STEPS) / PWM_STEPS
        force = duty * supply_v * motor.force_per_ampere / motor.resistance_ohm
        settled = force / motor.braking
        position += settled * TICK_S + (speed - settled) * lasting
        speed = settled + (speed - settled) * decay
        speeds.append(speed)
    return speeds
