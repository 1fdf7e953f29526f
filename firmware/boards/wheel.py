"""A wheel of a board: bridge (phase and enable), quadrature encoder and current sense."""

import micropython
from machine import ADC, Pin
from micropython import const

from mdms_cell.drive import speed_loop

PWM_HZ = 20_000
#: DRV8874 carrier: 1.1 V/A into an ADC of 3.3 V.
CURRENT_FULL_SCALE_MA = const(3_000)
#: Over any limit that is watched: twice `tuning.CURRENT_MAX_MA`.
CURRENT_TOO_LARGE_MA = const(2_000_000)

_SATURATED = const(64_000)
#: Least supply that a pulse width is worked out by: 1 V, in units of 4,096 uV.
_SUPPLY_MIN = const(1_000_000 >> 12)


class Wheel:
    """The axis with registers from `base` on; all but `off` is for the tick.

    `count()` is the encoder's position. `sense(registers)` writes the motor's current into the
    registers, signed as the voltage. `drive(registers)` sets phase and pulse width to the voltage
    in the registers. `set_width(width)` sets the pulses of a PWM; `steps` are full ones.
    """

    def __init__(self, base: int, *, count, set_width, steps: int, phase: Pin, current: ADC):
        voltage = base + speed_loop.VOLTAGE
        self.count = count
        self.sense = _sensing(voltage, base + speed_loop.CURRENT, current.read_u16)
        self.drive = _driving(voltage, phase, set_width, steps)
        self._set_width = set_width

    def off(self):
        """No pulse."""
        self._set_width(0)


# Functions of the tick have the peripherals' own methods as defaults of their arguments. To look up
# attributes in every tick takes twice the time of all the rest. A closure over more than a few
# variables allocates.


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
