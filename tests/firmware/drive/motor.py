"""A DC motor with its wheel and encoder, exact over a tick of held voltage (paper, eq 8).

`python tests/firmware/drive/motor.py` prints the response to a step of the reference, and that of a
wheel that is let go. Each is printed with an observer that is told of the voltage and without.
"""

import itertools
import math
from array import array
from collections.abc import Iterator
from dataclasses import dataclass

from mdms_cell.drive import speed_loop as s
from mdms_cell.drive import tuning
from mdms_protocol.dictionary import ENTRIES

TICK_S = 0.001
COUNTS_PER_METRE = 37_596
PWM_STEPS = 1000
SUPPLIES_V = (12, 24)
REFERENCES_M_S = (0.0635, 0.08, 0.1, 0.2, 0.5, 1.0)
#: The gain that a cell comes with [V s/m].
GAIN = ENTRIES[0x2000, 0].default // 1000
#: A speed is settled when it stays so near to its final value, relatively.
BAND = 0.05


@dataclass(frozen=True)
class Motor:
    """The paper's motor at 4 ohm with a rotor of 2e-6 kg m2, and a wheel of 2e-5 behind 3:1."""

    force_per_ampere: float = 0.024 * 3 / 0.0254  # Ke [N/A]
    resistance_ohm: float = 4.0
    damping_n_s_per_m: float = 3.5e-6 * (3 / 0.0254) ** 2  # Be
    mass_kg: float = 2e-6 * (3 / 0.0254) ** 2 + 2e-5 / 0.0254**2

    @property
    def braking(self) -> float:
        """Be + Ke^2 / Rm [N s/m]."""
        return self.damping_n_s_per_m + self.force_per_ampere**2 / self.resistance_ohm

    def free_speed(self, reference_m_s: float, gain: float) -> float:
        """Where a free wheel settles under V = G (r - v) [m/s] (eq 9 at no force)."""
        pull = gain * self.force_per_ampere / self.resistance_ohm
        return reference_m_s * pull / (pull + self.braking)


def registers(gain_mv_s_m: int = GAIN * 1000, supply_mv: int = 24_000, fed: bool = True):
    """The registers of a cell whose first axis runs."""
    made = array("i", [0] * s.REGISTERS)
    s.reset(made)
    made[s.AGE_LIMIT] = 1 << 29
    tuning.set_encoder(made, 0, COUNTS_PER_METRE)
    tuning.set_feed(made, 0, COUNTS_PER_METRE, tuning.ACCELERATION_PER_VOLT_MM_S2 if fed else 0)
    tuning.set_law(made, 0, gain_mv_s_m, supply_mv)
    made[s.MODE] = s.RUN
    return made


def run(made, motor: Motor, supply_v: float, ticks: int, start_counts: float = 0.0) -> list[float]:
    """The wheel's speed [m/s] at the end of every tick, from rest at a place of the encoder."""
    decay = math.exp(-motor.braking / motor.mass_kg * TICK_S)
    lasting = (1 - decay) * motor.mass_kg / motor.braking
    speed = 0.0
    position = start_counts / COUNTS_PER_METRE
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


_OFF = {"": 1.0, "-30": 0.7, "+30": 1.3}
#: The paper's motor, and those whose constants are 30 % off, one at a time and together.
MOTORS = {
    f"Ke{force} Rm{resistance}": Motor(
        force_per_ampere=Motor.force_per_ampere * _OFF[force],
        resistance_ohm=Motor.resistance_ohm * _OFF[resistance],
    )
    for force, resistance in itertools.product(_OFF, _OFF)
}


def steps(
    own: Motor, supply_v: int, reference_m_s: float, gain: int = GAIN, *, fed: bool = True
) -> Iterator[list[float]]:
    """Speeds after a step, over the final one, from several places between two counts."""
    final = own.free_speed(reference_m_s, gain)
    for start_counts in (0.0, 0.2, 0.35, 0.55, 0.7, 0.9):
        made = registers(gain * 1000, supply_v * 1000, fed=fed)
        made[s.TARGET] = round(reference_m_s * 1e6)
        yield [speed / final for speed in run(made, own, supply_v, 200, start_counts)]


def released(own: Motor, held_ticks: int, gain: int = GAIN, *, fed: bool = True) -> list[float]:
    """Speeds of a wheel that was held for so long and is let go, over its free speed."""
    made = registers(gain * 1000, fed=fed)
    made[s.TARGET] = 100_000
    run(made, Motor(mass_kg=1e6), 24, held_ticks)
    free = own.free_speed(0.1, gain)
    return [speed / free for speed in run(made, own, 24, 200)]


def settled_ms(speeds: list[float]) -> int:
    """When the speed, over the final one, is within the band and stays there."""
    return max(place for place, speed in enumerate(speeds) if abs(speed - 1) >= BAND) + 2


def main() -> None:
    """Print the worst overshoot and settling time of each motor, reference and supply."""
    for gain, fed in ((GAIN, True), (GAIN, False), (10, False)):
        print(f"gain {gain} V s/m,", "told of the voltage" if fed else "by the encoder alone")
        steps_of_all(gain, fed)
        for name in ("Ke Rm", "Ke+30 Rm-30"):
            speeds = released(MOTORS[name], 1000, gain, fed=fed)
            print(f"{name:<12} let go: {max(speeds) - 1:.1%}, {settled_ms(speeds)} ms")
        print()


def steps_of_all(gain: int, fed: bool) -> None:
    """A row for each motor and supply."""
    print("motor       ", *(f"{each:g} m/s".rjust(12) for each in REFERENCES_M_S))
    for (name, own), supply_v in itertools.product(MOTORS.items(), SUPPLIES_V):
        print(f"{name:<12}{supply_v:3} V", end="")
        for reference_m_s in REFERENCES_M_S:
            runs = list(steps(own, supply_v, reference_m_s, gain, fed=fed))
            overshoot = max(max(speeds) for speeds in runs) - 1
            print(f"{overshoot:7.1%}{max(map(settled_ms, runs)):3} ms", end="")
        print()


if __name__ == "__main__":
    main()
