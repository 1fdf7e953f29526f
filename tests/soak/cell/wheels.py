"""Two free wheels on the faked bridges and encoders of a PYBv1.1, in integers."""

import world

from boards.pybv11 import PINS

#: Timer of the encoder, place of the pulses and phase pin of each wheel.
WHEELS = tuple(
    [
        (PINS.encoders[place][0], (PINS.pwm_timer, place + 1), PINS.phases[place])
        for place in range(2)
    ]
)
#: Counts/1024 a millisecond that a step of pulse width gives to a free wheel.
_FREE_SPEED = 76
#: Time constant, as a shift of milliseconds.
_INERTIA = 4
_FINE = 10
_TURNS = (1 << 26) - 1


class Wheels:
    """Roll with the pulses they are given; motor and gear as in the paper, at 24 V."""

    def __init__(self):
        self._speed = [0, 0]
        self._travel = [0, 0]

    def roll(self):
        """Let a millisecond pass."""
        for place in range(2):
            timer, pulse, phase = WHEELS[place]
            width = world.pulses[pulse] if world.levels[phase] else -world.pulses[pulse]
            self._speed[place] += (width * _FREE_SPEED - self._speed[place]) >> _INERTIA
            travel = (self._travel[place] + self._speed[place]) & _TURNS
            self._travel[place] = travel
            world.counts[timer] = travel >> _FINE
