"""Wheels that do not follow: they are commanded to turn, and report that they stand."""

import numpy as np

from mdms_model.arrays import Bools, Floats

#: Commanded speeds at least so large [m/s].
_COMMANDED_M_S = 0.01
#: Reported speeds at most so large, absolutely [m/s] or of the commanded one: an observer that
#: takes new voltage into account reports some speed of a wheel that is held.
_STANDING_M_S = 0.002
_STANDING_SHARE = 0.1
#: A wheel follows again from this share of the commanded speed on.
_FOLLOWING_SHARE = 0.5
#: For so long [s]; or for as long as it takes to be commanded so far [m], but longer than a wheel
#: in order takes to get up to speed, which is some 30 ms.
_LIMIT_S = 0.3
_LIMIT_M = 0.015
_STARTING_S = 0.05


class Following:
    """Watches all wheels, shape (W,), and reports a standing wheel once, until it follows again.

    `standing` are the wheels that stand now. Their speeds show nothing of the parcels on them.
    """

    def __init__(self, wheels: int) -> None:
        self._standing_s: Floats = np.zeros(wheels)
        self._missed_m: Floats = np.zeros(wheels)
        self.standing: Bools = np.zeros(wheels, dtype=bool)

    def step(self, commanded_m_s: Floats, speed_m_s: Floats, step_s: float) -> list[int]:
        """Take in speeds commanded and reported; the wheels (from 0) found standing now."""
        commanded = abs(commanded_m_s) >= _COMMANDED_M_S
        slow_m_s = np.maximum(_STANDING_M_S, _STANDING_SHARE * abs(commanded_m_s))
        standing = commanded & (abs(speed_m_s) <= slow_m_s)
        self._standing_s = np.where(standing, self._standing_s + step_s, 0.0)
        missed_m = self._missed_m + abs(commanded_m_s) * step_s
        self._missed_m = np.where(standing, missed_m, 0.0)
        along_m_s = speed_m_s * np.sign(commanded_m_s)
        self.standing &= ~(commanded & (along_m_s > _FOLLOWING_SHARE * abs(commanded_m_s)))
        late = (self._standing_s > _LIMIT_S) | (self._missed_m > _LIMIT_M)
        found = late & (self._standing_s > _STARTING_S) & ~self.standing
        self.standing |= found
        return [int(wheel) for wheel in np.flatnonzero(found)]
