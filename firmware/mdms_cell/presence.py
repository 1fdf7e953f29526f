"""Presence bits without their flicker: a sensor counts once it has read the same for a while."""

from mdms_cell import ticks

SENSORS = 8


class Presence:
    """The debounced presence sensors; `bits` has bit k for sensor k.

    A sensor has to differ from `bits` for `debounce_ms` before its bit changes. So every change is
    late by that time, and by more only if a wrong reading comes between.
    """

    def __init__(self):
        self.bits = 0
        self.debounce_ms = 0
        self._differing = 0
        self._since_ms = [0] * SENSORS

    def read(self):
        """The bits, as the object dictionary has them."""
        return self.bits

    def step(self, reading, now_ms):
        """Take in a reading; in how many milliseconds another is due, if none differs before."""
        differing = reading ^ self.bits
        begun = differing & ~self._differing
        wait_ms = ticks.IDLE_MS
        for sensor in range(SENSORS if differing else 0):
            bit = 1 << sensor
            if not differing & bit:
                continue
            if begun & bit:
                self._since_ms[sensor] = now_ms
            left_ms = self.debounce_ms - ticks.diff(now_ms, self._since_ms[sensor])
            if left_ms <= 0:
                self.bits ^= bit
                differing ^= bit
            elif left_ms < wait_ms:
                wait_ms = left_ms
        self._differing = differing
        return wait_ms
