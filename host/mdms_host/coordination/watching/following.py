"""Wheels that do not follow: they are commanded to turn, and report that they stand."""

import numpy as np

from mdms_model.arrays import Bools, Floats

#: References at least so large [m/s], and reported speeds at most so large, for so long [s].
#: Smaller ones may be a push that a parcel at rest takes up. Under firmware in order a wheel is up
#: to speed after some 30 ms.
_COMMANDED_M_S = 0.03
_STANDING_M_S = 0.002
_LIMIT_S = 0.3


class Following:
    """Watches all wheels, shape (W,), and reports each that stands once, until it has turned.

    `standing` are those that stand now, of which the speed shows nothing of the parcel on them.
    """

    def __init__(self, wheels: int) -> None:
        self._standing_s: Floats = np.zeros(wheels)
        self.standing: Bools = np.zeros(wheels, dtype=bool)

    def step(self, reference_m_s: Floats, speed_m_s: Floats, step_s: float) -> list[int]:
        """Take in references and the speeds under them; the wheels (from 0) found standing now."""
        turning = abs(speed_m_s) > _STANDING_M_S
        standing = (abs(reference_m_s) >= _COMMANDED_M_S) & ~turning
        self._standing_s = np.where(standing, self._standing_s + step_s, 0.0)
        self.standing &= ~turning
        found = (self._standing_s > _LIMIT_S) & ~self.standing
        self.standing |= found
        return [int(wheel) for wheel in np.flatnonzero(found)]
