"""The part of `pyb` that the boards use."""

import stm
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
        if mode == Timer.ENC_AB:
            # Both inputs are set up by each call, without a filter.
            world.registers[stm.TIMERS[self.id] + stm.TIM_CCMR1] = 0x0101
        channel = Channel(self.id, number)
        if pulse_width is not None:
            channel.pulse_width(pulse_width)
        return channel

    def counter(self):
        """The count of the encoder."""
        return world.counts.get(self.id, 0) & world.periods[self.id]

    def callback(self, function):
        """Call another function at every period, or none."""
        self._callback = function

    def fire(self):
        """A period is over."""
        if self._callback is not None:
            self._callback(self)


class Flash:
    """The port's block device over `world.flash`, from `start` on; blank where there is none.

    As `storage.c` has it: blocks of 512 bytes; with an offset, the extended protocol. Nothing is
    erased by ioctl.
    """

    def __init__(self, *, start=-1, len=-1):
        assert start >= 0, "the device with the partition table is left out"
        self._flash = world.flash
        size = self._flash.size if self._flash else 0
        self._first = start // 512
        self._blocks = (size - start if len < 0 else len) // 512

    def readblocks(self, block, buffer, offset=0):
        """Read from a block on, with data that is written but not programmed yet."""
        if self._flash is None:
            buffer[:] = b"\xff" * len(buffer)
        else:
            self._flash.read((self._first + block) * 512 + offset, buffer)
        return 0

    def writeblocks(self, block, data, offset=0):
        """Write from a block on, into the cache."""
        if self._flash is None or block >= self._blocks:
            return 5
        self._flash.write((self._first + block) * 512 + offset, data)
        return 0

    def ioctl(self, operation, _argument):
        """Answer a request of the file system."""
        if operation == 3:
            self._flash.sync()
        return {4: self._blocks, 5: 512}.get(operation, 0)
