"""How large a cell's gain may be: the phase margin of its sampled speed loop.

The loop is worked out exactly at its sampling instants: the wheel under a held voltage (paper, eq
8), the position read once a tick, the firmware's observer, an alpha-beta filter that takes new
voltage in, and the time from reading the encoder to setting the voltage. Within half a count the
observer takes only a share of an innovation; the margin is the smaller one of the loop with all of
it and with that.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mdms_model.arrays import Floats
from mdms_model.motor import drive_of, rim_mass_kg
from mdms_model.scenario.scenario import Cell
from mdms_protocol import indices
from mdms_protocol.dictionary import ENTRIES

_LAG = ENTRIES[indices.OBSERVER_LAG, 0]
_FEED = ENTRIES[indices.ACCELERATION_PER_VOLT, 0]

TICK_S = 0.001
#: How long a voltage is new to the firmware's observer.
NEW_TICKS = 16
#: From reading the encoder to the new voltage, on the slowest board.
DELAY_S = 0.0001
MARGIN_RAD = math.radians(45.0)
#: The best setting of the observer over what the motor's data give: a step of the reference is then
#: quick and calm for motors whose force and resistance are up to 30 % off.
FEED_SHARE = 5.0 / 3.0
#: What a wheel may seem to weigh under a parcel, over what it weighs; one that stands is added.
LOADS = (1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 15.0, 50.0)
#: What the observer takes of an innovation beyond half a count, and within.
SHARES = (1.0, 0.375)

_FREQUENCIES = 20_000
_SLOWEST_HZ = 0.01

Complex = NDArray[np.complex128]


class GainError(ValueError):
    """A gain that leaves less than the phase margin; the message has the largest that does not."""


@dataclass(frozen=True, slots=True)
class Observer:
    """The settings of a cell's observer; by default those that the firmware comes with."""

    lag_s: float = _LAG.default * _LAG.unit.factor
    acceleration_m_s2_per_v: float = _FEED.default * _FEED.unit.factor

    @property
    def gains(self) -> tuple[float, float]:
        """Alpha and beta of the critically damped filter that trails an acceleration by the lag."""
        ratio = self.lag_s / TICK_S + 0.5
        beta = 4.0 / (ratio + 1.0) ** 2
        return ratio * beta, beta


DEFAULT = Observer()


@dataclass(frozen=True, slots=True)
class WheelMotor:
    """A motor seen from its wheel's rim: Ke, Rm and Be of the paper's eq 8, and its inertia."""

    force_n_per_a: float
    resistance_ohm: float
    damping_n_s_per_m: float
    mass_kg: float

    @property
    def braking_n_s_per_m(self) -> float:
        """Be + Ke^2 / Rm: how a shorted motor resists its wheel [N s/m]."""
        return self.damping_n_s_per_m + self.force_n_per_a**2 / self.resistance_ohm


def motor_of(cell: Cell) -> WheelMotor:
    """The motor of a scenario's cells as its wheel's rim sees it."""
    drive = drive_of(cell)
    return WheelMotor(
        force_n_per_a=drive.ke,
        resistance_ohm=cell.resistance_ohm,
        damping_n_s_per_m=drive.be,
        mass_kg=rim_mass_kg(cell),
    )


def observer_for(motor: WheelMotor) -> Observer:
    """The firmware's observer with the acceleration per volt that suits a motor.

    A wheel without inertia has none: its speed is left to the encoder.
    """
    if motor.mass_kg == 0.0:
        return replace(DEFAULT, acceleration_m_s2_per_v=0.0)
    acceleration = motor.force_n_per_a / motor.resistance_ohm / motor.mass_kg
    largest = _FEED.high * _FEED.unit.factor
    return replace(DEFAULT, acceleration_m_s2_per_v=min(FEED_SHARE * acceleration, largest))


@lru_cache(maxsize=256)
def largest_gain(
    motor: WheelMotor, observer: Observer = DEFAULT, margin_rad: float = MARGIN_RAD
) -> float:
    """The largest gain G [V s/m] whose loop keeps the phase margin [rad] under any load.

    A parcel on the wheel adds mass: all of LOADS are tried, and a wheel that nothing moves.
    """
    return min(_largest_gain(loop, margin_rad) for loop in _open_loops(motor, observer))


def phase_margin(motor: WheelMotor, gain_vs_per_m: float, observer: Observer = DEFAULT) -> float:
    """The phase margin [rad] at a gain G [V s/m]; infinite if the loop's gain is below 1 always."""
    return min(_phase_margin(gain_vs_per_m * loop) for loop in _open_loops(motor, observer))


def check_gain(motor: WheelMotor, gain_vs_per_m: float, observer: Observer = DEFAULT) -> None:
    """Raises GainError for a gain [V s/m] that leaves less than 45 degrees of phase margin."""
    largest = largest_gain(motor, observer)
    if gain_vs_per_m > largest:
        margin_deg = math.degrees(phase_margin(motor, gain_vs_per_m, observer))
        raise GainError(
            f"a gain of {gain_vs_per_m:g} V s/m leaves this motor a phase margin of "
            f"{margin_deg:.0f} degrees; the largest that leaves 45 is {largest:.4g} V s/m"
        )


def _largest_gain(loop: Complex, margin_rad: float) -> float:
    short = np.unwrap(np.angle(loop)) <= margin_rad - math.pi
    if not short.any():
        return math.inf
    return float(1.0 / np.abs(loop[np.argmax(short) :]).max())


def _phase_margin(loop: Complex) -> float:
    over = np.abs(loop) >= 1.0
    if not over.any():
        return math.inf
    return float(math.pi + np.unwrap(np.angle(loop))[over].min())


def _open_loops(motor: WheelMotor, observer: Observer) -> Iterator[Complex]:
    """From speed error to observed speed at gain 1, from slow to the Nyquist frequency."""
    omega: Floats = 2 * math.pi * np.geomspace(_SLOWEST_HZ, 0.5 / TICK_S, _FREQUENCIES)
    later = np.exp(1j * omega * TICK_S)
    delay: Complex = np.exp(-1j * omega * DELAY_S)
    for share in SHARES:
        by_position, by_voltage = _observed(observer, share, later)
        for load in LOADS:
            position = _position(replace(motor, mass_kg=load * motor.mass_kg), later)
            yield (position * by_position + by_voltage) * delay
        yield by_voltage * delay


def _position(motor: WheelMotor, later: Complex) -> Complex:
    """Position [m] by held voltage [V]; `later` is z."""
    braking = motor.braking_n_s_per_m
    force = motor.force_n_per_a / motor.resistance_ohm
    if motor.mass_kg > 0.0:
        decay = math.exp(-braking * TICK_S / motor.mass_kg)
        lasting = (1.0 - decay) * motor.mass_kg / braking
    else:
        decay = lasting = 0.0
    speed = (1.0 - decay) / (later - decay)
    travel: Complex = TICK_S - lasting + lasting * speed
    return force / braking * travel / (later - 1.0)


def _observed(observer: Observer, share: float, later: Complex) -> tuple[Complex, Complex]:
    """Observed speed [m/s] by position [m] and by voltage [V]."""
    alpha, beta = (share * gain for gain in observer.gains)
    earlier = 1.0 / later
    change = 1.0 - earlier
    filtered = change**2 + alpha * earlier * change + beta * earlier
    new = (later - 1.0) / (later - 1.0 + 1.0 / NEW_TICKS)
    fed = observer.acceleration_m_s2_per_v * TICK_S * earlier * new
    by_position: Complex = beta / TICK_S * change / filtered
    by_voltage: Complex = fed * (change + alpha * earlier - beta) / filtered
    return by_position, by_voltage
