"""A Kalman filter over a parcel's pose, and over how much larger it is than its drawing.

It is corrected by edges ('this point is on the outline') and by bounds ('this point is on the other
side of the outline'). It is as sure of itself as both have been right.

It is less sure where all wheels under the parcel slip alike. No speed of a wheel shows that, but
their pushes do. A parcel gains what its wheels push it to, and wheels that gain more than that
slip. The surplus of their gain is how much faster they are.
"""

from math import erfc, exp, hypot, pi, sqrt

import numpy as np

from mdms_model.arrays import Floats
from mdms_model.scenario.scenario import DRAWN_M

#: Odometry errs by a random walk: this variance a metre of way, and this a second [m; m2/s].
_SLIP_M = 5e-6
_DRIFT_M2_S = 1e-10
#: An error of more standard deviations is not believed; of fewer, but of so many, it shows that the
#: filter has been too sure of itself.
_GATE = 5.0
_SURPRISE = 2.0
#: An error of so little is believed however sure the filter is [m].
_NEAR_M = 0.012
#: Bounds do not make the filter surer of a distance than this: a bound that is met again a moment
#: later is the same measurement [m].
_BOUND_M = 0.003
#: A size is told no better than this, when edges surprise [m].
_LEAST_SPREAD_M = 0.001
#: No variance becomes smaller [m2, rad2].
_LEAST_M2 = 1e-12
#: However often it is surprised: a parcel is somewhere about here, turned somehow [m, rad].
_UNSURE_M, _UNSURE_RAD = 1.0, pi


class PoseFilter:
    """Pose (x, y, yaw) [m, m, rad], and growth along the parcel's own x and y [m].

    `mean` is of shape (5,), `covariance` of shape (5, 5). `extent_m` is how far the parcel reaches
    from its centre, `spread_m` how exact its drawing is on either side (one standard deviation).
    """

    def __init__(
        self,
        pose: Floats,
        covariance: Floats,
        extent_m: float,
        growth: Floats,
        spread_m: float = DRAWN_M,
    ) -> None:
        self.mean: Floats = np.concatenate((pose, growth))
        self.covariance: Floats = np.zeros((5, 5))
        self.covariance[:3, :3] = covariance
        self.covariance[3, 3] = self.covariance[4, 4] = spread_m**2
        self._extent_m = extent_m
        size_m = max(spread_m, _LEAST_SPREAD_M)
        self._most = np.array([_UNSURE_M, _UNSURE_M, _UNSURE_RAD, size_m, size_m])
        self._walk = np.array([1.0, 1.0, 1.0 / extent_m**2])

    def move(self, moved: Floats, step_s: float, slip_m2_s: float = 0.0) -> None:
        """The wheels have carried the parcel by so much, shape (3,), and slipped.

        `slip_m2_s` is the variance of the place that slip adds in a second.
        """
        x_m, y_m, yaw_rad = moved.tolist()
        way_m = hypot(x_m, y_m) + abs(yaw_rad) * self._extent_m
        self.mean[:3] += moved
        variance_m2 = _SLIP_M * way_m + (_DRIFT_M2_S + slip_m2_s) * step_s
        # The first three of the diagonal.
        self.covariance.reshape(-1)[:18:6] += variance_m2 * self._walk

    def place(self, mean: Floats, covariance: Floats) -> None:
        """Set the pose, or pose and growth, (3,) or (5,), regardless of the state before."""
        count = len(mean)
        self.mean[:count] = mean
        self.covariance[:count, count:] = self.covariance[count:, :count] = 0.0
        self.covariance[:count, :count] = covariance

    def stretch(self, moved: Floats) -> None:
        """The parcel may have moved by so much more, or less, shape (3,)."""
        self.covariance[:3, :3] += np.outer(moved, moved)

    def blur(self, deviation_m: float) -> None:
        """The parcel may have moved by so much any way, a corner's way by turning included."""
        self.covariance[range(3), range(3)] += deviation_m**2 * self._walk

    def on_edge(self, off_m: float, slope: Floats, sigma_m: float) -> bool:
        """A point is on the outline, and was believed `off_m` outside; False if unbelievable.

        `slope` is the derivative of that by the state, shape (5,).
        """
        variance_m2 = self._admit(off_m, slope, sigma_m)
        if variance_m2 is None:
            return False
        self._correct(self.covariance @ slope / variance_m2, -off_m, variance_m2)
        return True

    def on_bound(self, off_m: float, slope: Floats, sigma_m: float) -> bool:
        """A point is beyond the outline by `off_m`, on the wrong side; False if unbelievable.

        The distance becomes the part of a normal distribution on the right side of zero.
        """
        variance_m2 = self._admit(off_m, slope, sigma_m)
        if variance_m2 is None:
            return False
        deviation_m = sqrt(variance_m2)
        beyond = abs(off_m) / deviation_m
        # The mean of that part, and how much narrower it is.
        shift = exp(-(beyond**2) / 2) / sqrt(2 * pi) / (0.5 * erfc(beyond / sqrt(2)))
        narrower = 1 - shift * (shift - beyond)
        narrower = max(narrower, min(1.0, _BOUND_M**2 / variance_m2))
        toward_m = -shift * deviation_m if off_m > 0 else shift * deviation_m
        self._correct(self.covariance @ slope / variance_m2, toward_m, variance_m2 * (1 - narrower))
        return True

    def admits(self, off_m: float, slope: Floats) -> bool:
        """Whether a distance that is measured `off_m` away can be believed."""
        believed_m2 = float(slope @ self.covariance @ slope)
        return off_m**2 <= max(_GATE**2 * believed_m2, _NEAR_M**2)

    def _admit(self, off_m: float, slope: Floats, sigma_m: float) -> float | None:
        """The variance of a distance that is measured `off_m` away [m2]; None if unbelievable.

        A surprise makes the filter as unsure as it should have been.
        """
        believed_m2 = float(slope @ self.covariance @ slope)
        variance_m2 = believed_m2 + sigma_m**2
        if off_m**2 > max(_GATE**2 * variance_m2, _NEAR_M**2):
            return None
        if off_m**2 > _SURPRISE**2 * variance_m2:
            variance_m2 = off_m**2 / _SURPRISE**2
            larger = (variance_m2 - sigma_m**2) / believed_m2
            # Asymmetry by rounding would grow with every surprise.
            self.covariance = (self.covariance + self.covariance.T) * (larger / 2)
            self._limit()
            # Without its tie to growth, the distance may be less sure than by the surprise.
            believed_m2 = float(slope @ self.covariance @ slope)
            variance_m2 = max(variance_m2, believed_m2 + sigma_m**2)
        return variance_m2

    def _limit(self) -> None:
        """Bound the variances after a surprise.

        The surprise is sooner the wheels' slip than another size, so a size stays as sure as told.
        If a size is told far too well, each edge shows a little more. And a variance that no edge
        shows, such as the yaw of a disc, would grow with every surprise.
        """
        deviations = np.sqrt(self.covariance.diagonal())
        scale = np.minimum(1.0, self._most / np.maximum(deviations, 1e-9))
        self.covariance *= np.outer(scale, scale)

    def _correct(self, gain: Floats, toward_m: float, less_m2: float) -> None:
        """Shift the distance by `toward_m`, and take `less_m2` from its variance."""
        self.mean = self.mean + gain * toward_m
        self.covariance = self.covariance - np.outer(gain, gain) * less_m2
        # Rounding may take from a variance more than there is.
        np.fill_diagonal(self.covariance, np.maximum(self.covariance.diagonal(), _LEAST_M2))


#: Motors differ: wheels that roll seem to gain so much more than they push to, or less [m/s2].
_ROLLING_SHARE = 0.08
_ROLLING_M_S2 = 0.05
#: They slip once they are so much faster than that explains [m/s].
_SLIPPING_M_S = 0.018
#: They roll again where they are no faster than this [m/s].
_ROLLING_M_S = 0.005
#: They roll, too, where they push with less than this share of their push at the slip, as a mean
#: over so long [s].
_ROLLING_PUSH = 0.5
_MEAN_S = 0.03
#: A slip that is not confirmed any more is over after such a time [s].
_OVER_S = 0.2
#: How much faster they are is about the same for so long [s].
_SAME_S = 0.1


class Sliding:
    """`twist` (3,) is how much faster the wheels are than the parcel; zero where they roll.

    `corner_m` (3,) divides a twist into speeds of a corner.
    """

    def __init__(self, corner_m: Floats) -> None:
        self._corner_m = corner_m
        self._faster: Floats = np.zeros(3)
        # The part of that which rolling does not explain [m/s].
        self._unexplained_m_s = 0.0
        # Their push on the parcel, and that at which they were found to slip [m/s2].
        self._pushed: Floats = np.zeros(3)
        self._most_m_s2 = 0.0
        # Whether they do, or have done so, and whether the parcel catches up with them.
        self._slips = self._slipped = self._catching_up = False

    @property
    def twist(self) -> Floats:
        """How much faster the wheels are."""
        return self._faster * self._corner_m if self._slips else np.zeros(3)

    @property
    def variance_m2_s(self) -> float:
        """Variance of the place that the slip adds in a second [m2/s].

        It is no correction: a parcel that is lighter than believed looks the same.
        """
        return float(self._faster @ self._faster) * _SAME_S if self._slips else 0.0

    def step(self, missing: Floats, gained: Floats, step_s: float) -> None:
        """In a step wheels gained so much a second, `missing` of which did not push the parcel."""
        before, missing = self._faster, missing / self._corner_m
        gained_m_s2 = float(np.linalg.norm(gained / self._corner_m))
        rolling_m_s2 = _ROLLING_M_S2 + _ROLLING_SHARE * gained_m_s2
        missing_m_s2 = float(np.linalg.norm(missing))
        self._faster = before + missing * step_s
        pushed = gained / self._corner_m - missing
        self._pushed = self._pushed + (pushed - self._pushed) * (1.0 - exp(-step_s / _MEAN_S))
        push_m_s2 = float(np.linalg.norm(self._pushed))
        if missing_m_s2 < rolling_m_s2:
            self._faster = self._faster * exp(-step_s / _OVER_S)
        slow = float(np.linalg.norm(self._faster)) < _ROLLING_M_S
        caught_up = self._catching_up and float(before @ self._faster) <= 0.0
        # Friction gives all it can while they slip.
        rolls = push_m_s2 < _ROLLING_PUSH * self._most_m_s2
        if self._slipped and (slow or caught_up or rolls):
            self.begin_again()
        if self._catching_up:
            # Speed that they lose now is no slip the other way.
            return
        same_way = float(before @ missing) >= 0.0
        unexplained_m_s2 = (missing_m_s2 if same_way else -missing_m_s2) - rolling_m_s2
        self._unexplained_m_s += unexplained_m_s2 * step_s
        if self._unexplained_m_s > 0.0:
            self._slips = self._unexplained_m_s > _SLIPPING_M_S
            if self._slips and not self._slipped:
                self._slipped, self._most_m_s2 = True, push_m_s2
        elif self._slipped:
            self._slips, self._catching_up = False, True
        else:
            self.begin_again()

    def begin_again(self) -> None:
        """The wheels roll, as far as is known."""
        self._faster, self._unexplained_m_s = np.zeros(3), 0.0
        self._slips = self._slipped = self._catching_up = False
