"""The part of `machine` that only the mimxrt port has, as MicroPython 1.29's sources say.

Left out: what else these classes can do; the phase of PWM channels to each other.
"""

import world
from machine import WDT

_LEAST_MS = 500
_STEP_MS = 500


class PWM:
    """A FlexPWM channel; a width of 65535 is a full one."""

    def __init__(self, pin, freq, duty_u16):
        world.told.append(("pwm", pin.name, freq))
        self._pin = pin.name
        self.duty_u16(duty_u16)

    def duty_u16(self, width):
        """Set how long the pulses are."""
        if width > 0xFFFF:
            raise ValueError("value larger than period")
        world.pulses[self._pin] = width


class Encoder:
    """A quadrature decoder: counts from `min` to `max`, a whole period a count unless told."""

    def __init__(self, id, phase_a, phase_b, *, phases=1, max=0, min=0):
        world.told.append(("encoder", id, phase_a.name, phase_b.name))
        self._id = id
        self._divisor = 4 // phases
        self._modulus = (max or 0xFFFFFFFF) + 1
        assert min == 0, "not needed"

    def value(self):
        """The count of the encoder."""
        count = world.counts.get(self._id, 0) // self._divisor % self._modulus
        count = count - (1 << 32) if count >= 1 << 31 else count
        assert -(1 << 30) <= count < 1 << 30, "an interrupt cannot allocate so long an integer"
        return count


class Timer:
    """A soft timer, which calls from an interrupt if it is a hard one."""

    PERIODIC = 1

    def __init__(self, id, *, mode, freq, callback, hard=False):
        assert (id, mode, hard) == (-1, Timer.PERIODIC, True)
        world.told.append(("timer", id, freq))
        self._callback = callback
        world.timers.append(self)

    def deinit(self):
        """No more calls."""
        world.timers.remove(self)

    def fire(self):
        """A period is over."""
        self._callback(self)


class Watchdog(WDT):
    """That of an i.MX RT: half a second at least, and in steps of that."""

    def __init__(self, timeout=5000):
        super().__init__(max(timeout, _LEAST_MS) // _STEP_MS * _STEP_MS)
