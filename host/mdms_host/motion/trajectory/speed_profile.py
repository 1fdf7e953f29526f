"""Greatest speed of a parcel along its path, from which friction and motors can still stop it.

Along a straight piece the push of the wheels bounds the path's acceleration s'', at any speed up to
the cap. Let E(s) be the integral of that bound. A parcel at rest at s0 has at most
s'^2 = 2 (E(s) - E(s0)) later. A parcel that stops at s1 has at most s'^2 = 2 (E(s1) - E(s)) before.
These are the two passes of time-optimal path parameterisation (Bobrow; Shin and McKay; TOPP-RA).

The reference (s, s') is the wanted place of a parcel on its path, and its speed. It starts at the
parcel's place, and speeds up as the profile's bounds allow. It can at any time stop before the
movement authority: the path coordinate up to which the way is free.
"""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf, sqrt

import numpy as np

from mdms_host.motion.trajectory.path import Path
from mdms_host.motion.trajectory.pushes import Pushes
from mdms_model.arrays import Floats


@dataclass(frozen=True)
class SpeedProfile:
    """Bounds at samples (M,) of the path coordinate `s_m`, rising; corners are among them.

    `acceleration_m_s2` (M - 1,) is the bound between two samples, for starting and stopping alike.
    `cap_m_s` (M,) is the bound of the speed. `pushes` are the parts of the samples, each as
    (index of its first sample, shares). The parcel rests at the path's ends and corners.
    """

    path: Path
    s_m: Floats
    acceleration_m_s2: Floats
    cap_m_s: Floats
    pushes: tuple[tuple[int, Pushes], ...]

    @cached_property
    def duration_s(self) -> float:
        """Time from rest at the start to rest at the end, never slower than the bounds say."""
        both_m_s = self.speeds_m_s[:-1] + self.speeds_m_s[1:]
        return float((2 * np.diff(self.s_m) / both_m_s).sum())

    @cached_property
    def speeds_m_s(self) -> Floats:
        """The greatest speed at each sample [m/s], (M,): forward from rest, and backward."""
        speeds_m_s: Floats = np.sqrt(_passed(self._backward, np.diff(self._climbs)))
        return speeds_m_s

    def acceleration_at(self, s_m: float) -> float:
        """The bound of s'' at a path coordinate [m/s2]."""
        last = len(self.acceleration_m_s2) - 1
        if last < 0:
            return 0.0
        return self._accelerations[min(max(bisect_right(self._samples, s_m) - 1, 0), last)]

    def climb(self, s_m: float) -> float:
        """E(s), half the square of the speed that could be gained from 0 to there [m2/s2]."""
        return _interpolated(s_m, self._samples, self._climbs)

    def ahead_at(self, s_m: float) -> float:
        """Square of the greatest speed from which all caps and stops ahead can be met [m2/s2]."""
        return _interpolated(s_m, self._samples, self._backward)

    def stop_after(self, s_m: float) -> float:
        """The next path coordinate, beyond this one, at which the parcel rests anyway [m]."""
        return next((each for each in self.path.corners_m if each > s_m), self.path.length_m)

    def part_at(self, s_m: float) -> tuple[Pushes, int]:
        """The shares at the sample nearest to a path coordinate, and its place among them."""
        sample = bisect_right(self._samples, s_m) - 1
        sample = min(max(sample, 0), len(self._samples) - 1)
        if sample + 1 < len(self._samples):
            before_m, after_m = s_m - self._samples[sample], self._samples[sample + 1] - s_m
            sample += int(after_m < before_m)
        first, pushes = next(part for part in reversed(self.pushes) if part[0] <= sample)
        return pushes, min(sample - first, len(pushes.poses) - 1)

    @cached_property
    def _samples(self) -> list[float]:
        return list(map(float, self.s_m))

    @cached_property
    def _accelerations(self) -> list[float]:
        return list(map(float, self.acceleration_m_s2))

    @cached_property
    def _climbs(self) -> list[float]:
        gained = self.acceleration_m_s2 * np.diff(self.s_m)
        return [0.0, *np.cumsum(gained).tolist()]

    @cached_property
    def _backward(self) -> list[float]:
        return _passed(self._resting_caps[::-1].tolist(), np.diff(self._climbs)[::-1])[::-1]

    @cached_property
    def _resting_caps(self) -> Floats:
        """Square of the cap at each sample; 0 at both ends and at corners."""
        squares: Floats = self.cap_m_s**2
        rests = np.searchsorted(self.s_m, [0.0, *self.path.corners_m])
        squares[np.minimum(rests, len(squares) - 1)] = 0.0
        return squares


def _passed(squares: Sequence[float], gains: Floats) -> list[float]:
    """One pass: from each sample to the next the square grows by twice the gain at most."""
    at, passed = inf, []
    for square, gain in zip(squares, [0.0, *gains.tolist()], strict=True):
        at = min(square, at + 2 * gain)
        passed.append(at)
    return passed


def _interpolated(x: float, xs: Sequence[float], ys: Sequence[float]) -> float:
    """The same as `np.interp`, which takes several times as long for a single number."""
    above = bisect_right(xs, x)
    if not 0 < above < len(xs):
        return ys[0] if not above else ys[-1]
    below = above - 1
    slope = (ys[above] - ys[below]) / (xs[above] - xs[below])
    return slope * (x - xs[below]) + ys[below]


#: It is where it is to stop within this [m].
_THERE_M = 2e-5
#: Rounds in which the speed after a step is found: to a thousandth of the change in a step.
_ROUNDS = 12


class Reference:
    """Path coordinate `s_m` and speed `speed_m_s` on a profile, from rest at its start.

    `share` of the bounds of acceleration is made use of; more only for braking, where it cannot be
    helped: wheels that slip brake as well as friction can.
    """

    def __init__(self, profile: SpeedProfile) -> None:
        self.profile = profile
        self.share = 1.0
        self.s_m = 0.0
        self.speed_m_s = 0.0

    @property
    def at_rest(self) -> bool:
        """Whether it stands."""
        return self.speed_m_s == 0.0

    @property
    def finished(self) -> bool:
        """Whether it stands at the end of the path."""
        return self.at_rest and self.s_m >= self.profile.path.length_m

    @property
    def _bound_m_s2(self) -> float:
        return self.profile.acceleration_at(self.s_m)

    def brake(self, step_s: float) -> None:
        """Move on by a step, and towards rest."""
        self._move(max(0.0, self.speed_m_s - self._bound_m_s2 * step_s), step_s)

    def advance(self, step_s: float, authority_s_m: float = inf) -> None:
        """Move on by a step, as fast as it may.

        Where the authority is nearer than it can stop, it overruns that, braking.
        """
        slowest_m_s = max(0.0, self.speed_m_s - self._bound_m_s2 * step_s)
        stop_m = min(self.profile.stop_after(self.s_m + _THERE_M), authority_s_m)
        left_m = stop_m - self.s_m
        if slowest_m_s == 0.0 and 0.0 <= left_m <= self.speed_m_s * step_s / 2 + _THERE_M:
            self.s_m, self.speed_m_s = stop_m, 0.0
        else:
            self._move(self._next_m_s(slowest_m_s, step_s, stop_m), step_s)

    def join(self, s_m: float, speed_m_s: float) -> None:
        """Go on from elsewhere on the path, where it may at this speed."""
        allowed_m_s = sqrt(max(self.share * self.profile.ahead_at(s_m), 0.0))
        self.s_m, self.speed_m_s = s_m, min(max(speed_m_s, 0.0), allowed_m_s)

    def stop_at(self) -> float:
        """The path coordinate at which it rests next, or rests now."""
        return self.profile.stop_after(self.s_m - _THERE_M)

    def _next_m_s(self, slowest_m_s: float, step_s: float, stop_m: float) -> float:
        """The greatest speed after the step, of those that friction allows, that can be stopped."""
        gained_m_s = self.share * self._bound_m_s2 * step_s
        low_m_s, high_m_s = slowest_m_s, self.speed_m_s + gained_m_s
        if self._can_stop(high_m_s, step_s, stop_m):
            return high_m_s
        if not self._can_stop(low_m_s, step_s, stop_m):
            return low_m_s
        for _ in range(_ROUNDS):
            middle_m_s = (low_m_s + high_m_s) / 2
            if self._can_stop(middle_m_s, step_s, stop_m):
                low_m_s = middle_m_s
            else:
                high_m_s = middle_m_s
        return low_m_s

    def _can_stop(self, speed_m_s: float, step_s: float, stop_m: float) -> bool:
        """Whether, at this speed after the step, all that is ahead can be met, and the stop too."""
        s_m = self.s_m + (self.speed_m_s + speed_m_s) / 2 * step_s
        if s_m > stop_m:
            return False
        profile = self.profile
        gained = min(profile.climb(stop_m) - profile.climb(s_m), profile.ahead_at(s_m) / 2)
        return speed_m_s**2 <= 2 * self.share * gained + 1e-12

    def _move(self, speed_m_s: float, step_s: float) -> None:
        s_m = self.s_m + (self.speed_m_s + speed_m_s) / 2 * step_s
        self.s_m, self.speed_m_s = min(s_m, self.profile.path.length_m), speed_m_s
