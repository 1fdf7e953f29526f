"""A wheel of an STM32 board: bridge (phase and enable), quadrature encoder and current sense."""

import micropython
from machine import ADC, Pin
from micropython import const
from pyb import Timer

from mdms_cell.drive import speed_loop

PWM_HZ = 20_000
#: DRV8874 carrier: 1.1 V/A into an ADC of 3.3 V.
CURRENT_FULL_SCALE_MA = const(3_000)
#: Over any limit that is watched.
CURRENT_TOO_LARGE_MA = const(2 * CURRENT_FULL_SCALE_MA)

_SATURATED = const(64_000)
#: Least supply that a pulse width is worked out by: 1 V, in units of 4,096 uV.
_SUPPLY_MIN = const(1_000_000 >> 12)


class Wheel:
    """The axis whose registers are at `base`; all but `off` is for the tick.

    `count()` is the encoder's, `sense(registers)` writes the motor's current into the registers,
    signed as the voltage, and `drive(registers)` sets phase and pulse width to the voltage there.
    `pulse` is a PWM channel whose full width is `steps`.
    """

    def __init__(self, base: int, *, encoder: Timer, pulse, steps: int, phase: Pin, current: ADC):
        voltage = base + speed_loop.VOLTAGE
        self.count = encoder.counter
        self.sense = _sensing(voltage, base + speed_loop.CURRENT, current.read_u16)
        self.drive = _driving(voltage, phase, pulse.pulse_width, steps)
        self._pulse_width = pulse.pulse_width

    def off(self):
        """No pulse."""
        self._pulse_width(0)


# What the tick calls has the peripherals' own methods as defaults of its arguments: to look up
# attributes in every tick takes twice the time of all the rest, and a closure over more than a
# few variables allocates.


def _sensing(voltage, current, read_u16):
    @micropython.native
    def sense(registers, voltage=voltage, current=current, read_u16=read_u16):
        reading = read_u16()
        current_ma = reading * CURRENT_FULL_SCALE_MA >> 16
        if reading > _SATURATED:  # its upper end is over any limit
            current_ma = CURRENT_TOO_LARGE_MA
        if registers[voltage] < 0:
            current_ma = -current_ma
        registers[current] = current_ma

    return sense


def _driving(voltage, phase, set_width, steps):
    @micropython.native
    def drive(  # noqa: PLR0917 - not given, but bound
        registers,
        voltage=voltage,
        forward=phase.high,
        backward=phase.low,
        set_width=set_width,
        steps=steps,
    ):
        voltage_uv = registers[voltage]
        if voltage_uv < 0:
            backward()
            voltage_uv = -voltage_uv
        else:
            forward()
        supply = registers[speed_loop.SUPPLY] >> 12
        width = (voltage_uv >> 12) * steps // (supply if supply > _SUPPLY_MIN else _SUPPLY_MIN)
        set_width(width if width < steps else steps)

    return drive


def pulses(timer, source_hz, pins):
    """PWM channels 1 and 2 of a timer at `PWM_HZ`, one a pin, and their full width."""
    steps = source_hz // PWM_HZ
    pwm = Timer(timer, prescaler=0, period=steps - 1)
    channels = [
        pwm.channel(place + 1, Timer.PWM, pin=pins[place], pulse_width=0)
        for place in range(len(pins))
    ]
    return channels, steps


def encoder(timer, pin_a, pin_b):
    """A timer that counts the edges of a quadrature encoder, modulo 2**16."""
    counter = Timer(timer, prescaler=0, period=0xFFFF)
    counter.channel(1, Timer.ENC_AB, pin=pin_a)
    counter.channel(2, Timer.ENC_AB, pin=pin_b)
    return counter
