"""The worth of each presence sensor: a sensor that contradicts all others is not believed."""

import numpy as np

from mdms_model.arrays import Bools, Floats

#: A sensor is not believed any more once it has been wrong for so long [s]; where it is right it
#: makes up for that this many times slower, up to the limit.
_WRONG_S = 0.3
_SLOWER = 10.0
_MOST_S = 1.0


class SensorWorth:
    """How long each of so many sensors has been wrong of late; `believed` is of shape (S,)."""

    def __init__(self, sensors: int) -> None:
        self.believed: Bools = np.ones(sensors, dtype=bool)
        self._wrong_s: Floats = np.zeros(sensors)

    def step(self, wrong: Bools, right: Bools, step_s: float) -> list[int]:
        """Take in which sensors are wrong, and right; those not believed from now on."""
        change_s = step_s * (wrong.astype(np.float64) - right / _SLOWER)
        return self._settle(np.clip(self._wrong_s + change_s, 0.0, _MOST_S))

    def disbelieve(self, sensors: Bools) -> list[int]:
        """These have been found wrong; those of them that were believed until now."""
        return self._settle(np.where(sensors, _MOST_S, self._wrong_s))

    def believe(self, sensors: Bools) -> None:
        """These have been found right."""
        self._settle(np.where(sensors, 0.0, self._wrong_s))

    def _settle(self, wrong_s: Floats) -> list[int]:
        self._wrong_s = wrong_s
        believed = wrong_s < _WRONG_S
        fallen = self.believed & ~believed
        self.believed = believed
        return [int(sensor) for sensor in np.flatnonzero(fallen)]
