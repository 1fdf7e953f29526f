"""The part of `pyb` that the boards use."""

import world


class Channel:
    """A channel of a timer."""

    def __init__(self, timer, number):
        self._place = (timer, number)

    def pulse_width(self, width):
        """Set how long the pulses are."""
        world.pulses[self._place] = width


class Timer:
    """A timer that ticks with the world's clock, counts an encoder, or makes pulses."""

    PWM = 0
    ENC_AB = 11

    def __init__(self, id, freq=None, prescaler=None, period=None, callback=None):
        self.id = id
        self._callback = callback
        if freq is not None:
            assert freq == 1000
            world.told.append(("timer", id, freq))
            world.timers.append(self)
        else:
            assert prescaler == 0
            world.periods[id] = period

    def channel(self, number, mode, pin, pulse_width=None):
        """Give the channel a pin."""
        world.told.append(("channel", self.id, number, mode, pin.name))
        channel = Channel(self.id, number)
        if pulse_width is not None:
            channel.pulse_width(pulse_width)
        return channel

    def counter(self):
        """What the encoder has come to."""
        return world.counts.get(self.id, 0) & world.periods[self.id]

    def callback(self, function):
        """Call another function at every period, or none."""
        self._callback = function

    def fire(self):
        """A period is over."""
        if self._callback is not None:
            self._callback(self)
