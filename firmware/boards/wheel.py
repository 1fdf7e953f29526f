"""A wheel of an STM32 board: bridge (phase and enable), quadrature encoder and current sense."""

import micropython
from machine import ADC, Pin
from micropython import const
from pyb import Timer

from mdms_cell import speed_loop

PWM_HZ = 20_000
#: DRV8874 carrier: 1.1 V/A into an ADC of 3.3 V.
CURRENT_FULL_SCALE_MA = const(3_000)
#: Over any limit that is watched.
CURRENT_TOO_LARGE_MA = const(2 * CURRENT_FULL_SCALE_MA)

_SATURATED = const(64_000)


class Wheel:
    """The axis whose registers are at `base`; all but `off` is for the tick.

    `pulse` is a PWM channel whose full width is `steps`.
    """

    def __init__(self, base: int, *, encoder: Timer, pulse, steps: int, phase: Pin, current: ADC):
        self._encoder = encoder
        self._pulse = pulse
        self._steps = steps
        self._phase = phase
        self._current = current
        self._count = base + speed_loop.COUNT
        self._current_ma = base + speed_loop.CURRENT
        self._voltage = base + speed_loop.VOLTAGE

    @micropython.native
    def sense(self, registers):
        """Write the motor's current into the registers, signed as the voltage.

        A reading at its upper end counts twice, so that it is over any limit.
        """
        reading = self._current.read_u16()
        current_ma = reading * CURRENT_FULL_SCALE_MA >> 16
        if reading > _SATURATED:
            current_ma = CURRENT_TOO_LARGE_MA
        if registers[self._voltage] < 0:
            current_ma = -current_ma
        registers[self._current_ma] = current_ma

    @micropython.native
    def sample(self, registers):
        """Write the encoder's count into the registers."""
        registers[self._count] = self._encoder.counter() & 0xFFFF

    @micropython.native
    def drive(self, registers):
        """Set phase and pulse width to the voltage in the registers."""
        voltage_uv = registers[self._voltage]
        if voltage_uv < 0:
            self._phase.low()
            voltage_uv = -voltage_uv
        else:
            self._phase.high()
        width = (voltage_uv >> 12) * self._steps // (registers[speed_loop.SUPPLY] >> 12)
        self._pulse.pulse_width(min(width, self._steps))

    def off(self):
        """No pulse."""
        self._pulse.pulse_width(0)


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
