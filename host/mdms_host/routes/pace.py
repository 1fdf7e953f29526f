"""How long moves from rest to rest take."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from mdms_model.arrays import Floats
from mdms_model.compiled import compiled


class Pace(Protocol):
    """Times within straight moves from rest to rest, for planning: nobody has to keep to them."""

    def times_s(self, lengths_m: Floats, turns_m: Floats, shares: Floats) -> Floats:
        """When a share of a move is done, after its begin [s]; all arrays alike, as is the result.

        `turns_m` is the way of the farthest point of the outline as it turns about the centre, and
        `shares` are from 0 to 1. The time of share 1 is the duration; times rise with shares.
        """
        ...


@dataclass(frozen=True)
class TrapezoidPace:
    """A constant acceleration to a greatest speed, and the same back to rest.

    Both are of the centre and of the corners' turning together, as `motion.goal.Limits` has them.
    """

    speed_m_s: float = 0.3
    acceleration_m_s2: float = 0.6

    def __post_init__(self) -> None:
        if min(self.speed_m_s, self.acceleration_m_s2) <= 0.0:
            raise ValueError(
                f"speed and acceleration must be above 0, got {self.speed_m_s} m/s and "
                f"{self.acceleration_m_s2} m/s2"
            )

    def times_s(self, lengths_m: Floats, turns_m: Floats, shares: Floats) -> Floats:
        """When a share of a move is done, after its begin [s]."""
        most = self.speed_m_s, self.acceleration_m_s2
        return trapezoid_times_s(lengths_m, turns_m, shares, most)


@compiled
def trapezoid_times_s(
    lengths_m: Floats, turns_m: Floats, shares: Floats, most: tuple[float, float]
) -> Floats:
    """`TrapezoidPace.times_s` for the greatest speed [m/s] and the acceleration [m/s2]."""
    speed_m_s, acceleration_m_s2 = most
    ways_m = np.sqrt(lengths_m**2 + turns_m**2)
    ramps_m = np.minimum(ways_m / 2, speed_m_s**2 / (2 * acceleration_m_s2))
    ramps_s = np.sqrt(2 * ramps_m / acceleration_m_s2)
    durations_s = 2 * ramps_s + (ways_m - 2 * ramps_m) / speed_m_s
    done_m = shares * ways_m
    nearer_m = np.minimum(done_m, ways_m - done_m)
    on_ramp_s = np.sqrt(2 * np.maximum(np.minimum(nearer_m, ramps_m), 0.0) / acceleration_m_s2)
    from_end_s = on_ramp_s + np.maximum(nearer_m - ramps_m, 0.0) / speed_m_s
    times_s: Floats = np.where(2 * done_m <= ways_m, from_end_s, durations_s - from_end_s)
    return times_s
