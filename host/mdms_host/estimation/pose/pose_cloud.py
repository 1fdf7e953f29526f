"""The poses that the sensors still allow, while these are too far apart for a Kalman filter.

Before edges have passed, the poses that the bits allow form no ellipsoid: a rectangle may lie this
way or that, and the mean of both is often a pose that no sensor allows. So the poses themselves are
carried along with the wheels, and each counts as much as the sensors agree with it.
"""

import numpy as np

from mdms_host.estimation.footprint import Footprint
from mdms_model.arrays import Bools, Floats, Ints

#: So many poses are kept, and so many if each has its own size.
_POSES, _SIZED = 400, 2000
#: How well a sensor's distance from an edge is known: sizes are told a millimetre or two wrong, and
#: the bits of a sensor are some milliseconds old [m].
_EDGE_M = 0.002
#: No pose is ruled out by one sensor: it may be wrong with this chance.
_WRONG = 1e-3
#: Sensors are asked again once a corner has moved so far [m].
_ASKED_M = 0.002
#: Poses are drawn anew once so small a share of them counts, each by so much of the deviation off.
_COUNTING = 0.5
_KERNEL = 0.2
#: Within these deviations a Kalman filter takes over: across, and of a corner's way by turning [m].
_SMALL_M = 0.003
#: Poses differ about no sensor that is farther from the edge, in deviations of a corner.
_DEVIATIONS = 3.0
#: Added to a covariance without spread, so that it has a root.
_LEAST = 1e-15
#: A sensor that contradicts all poses by more is not believed [m].
_NEAR_M = 0.012


class PoseCloud:
    """Poses [m, m, rad; table frame] with weights, of a parcel with this footprint.

    The given poses are those that a search has found, (N, 3), `grid` (3,) apart. If the size is to
    be learned, each has its `growths` (N, 2), too: how much larger than the footprint the parcel is
    then, on either side, along its own x and y [m]. `mean` is of the pose, and of the growth if
    there is one, shape (3,) or (5,); `covariance` is of shape (3, 3) or (5, 5).
    """

    def __init__(
        self,
        footprint: Footprint,
        poses: Floats,
        weights: Floats,
        grid: Floats,
        growths: Floats | None = None,
    ) -> None:
        # Seeded, so that the same reports lead to the same belief.
        self._chance = np.random.default_rng(0)
        self._footprint = footprint
        extent_m = footprint.reach_m
        self._extents_m = np.array([1.0, 1.0, extent_m, 1.0, 1.0])[: 3 if growths is None else 5]
        # No sensor shows the yaw of a disc: it stays as it was assumed.
        shown = np.array([True, True, np.ptp(poses[:, 2]) > 0.0])
        self._hidden = np.zeros((len(self._extents_m),) * 2)
        np.fill_diagonal(self._hidden[:3, :3], np.where(shown, 0.0, grid**2 / 3))
        self._count = _POSES if growths is None else _SIZED
        drawn = self._drawn(weights)
        off = self._chance.uniform(-0.5, 0.5, (self._count, 3))
        self._states = poses[drawn] + np.where(shown, grid, 0.0) * off
        if growths is not None:
            self._states = np.concatenate((self._states, growths[drawn]), axis=1)
        self._weights: Floats = np.full(self._count, 1.0 / self._count)
        # How far a corner has moved since sensors were asked, their bits then, and whether these
        # were believable.
        self._moved_m = np.inf
        self._covered: Bools = np.empty(0, dtype=bool)
        self._believable = True

    @property
    def mean(self) -> Floats:
        """Of all poses, as they count."""
        first = self._states[0]
        mean: Floats = first + self._weights @ (self._states - first)
        return mean

    @property
    def covariance(self) -> Floats:
        """Of all poses, as they count."""
        off = self._states - self.mean
        covariance: Floats = (off * self._weights[:, None]).T @ off + self._hidden
        return covariance

    @property
    def small(self) -> bool:
        """Whether the poses are so close together that a normal distribution describes them."""
        return self._deviation_m < _SMALL_M

    @property
    def spread_m(self) -> float:
        """Distance from the mean pose's edge beyond which a sensor is alike at all poses [m]."""
        return _DEVIATIONS * (self._deviation_m + _EDGE_M)

    @property
    def _deviation_m(self) -> float:
        """Of a corner, the way it goes by turning included, where that is greatest."""
        spread_m2 = (self.covariance - self._hidden) * np.outer(self._extents_m, self._extents_m)
        return float(np.sqrt(max(np.linalg.eigvalsh(spread_m2)[-1], 0.0)))

    def move(self, moved: Floats) -> None:
        """The wheels have carried the parcel by so much, shape (3,)."""
        self._states[:, :3] += moved
        self._moved_m += float(np.hypot(*moved[:2]) + abs(moved[2]) * self._extents_m[2])

    def on_edge(self, point_m: Floats, late_m: float) -> None:
        """A point (2,) is on the outline, within the parcel's own motion meanwhile."""
        off_m = self._distances_m(point_m[None])[:, 0]
        variance_m2 = _EDGE_M**2 + late_m**2
        self._weigh(np.log(np.exp(-(off_m**2) / (2 * variance_m2)) + _WRONG))

    def on_bits(self, sensors_m: Floats, covered: Bools, asked: Bools) -> bool:
        """Sensors (S, 2) are covered, or not, (S,), of which some are asked, (S,).

        False if all poses contradict one by much.
        """
        if self._moved_m < _ASKED_M and np.array_equal(covered, self._covered):
            return self._believable
        self._moved_m, self._covered = 0.0, covered
        off_m = self._distances_m(sensors_m[asked])
        # How far each sensor is on the wrong side of the edge.
        wrong_m = np.where(covered[asked], off_m, -off_m)
        self._believable = bool(wrong_m.max(axis=1, initial=0.0).min() < _NEAR_M)
        # A bit that is asked again is the same measurement. So poses of their own sizes that agree
        # count alike: those near the edge would get lost before it passes.
        sized = len(self._extents_m) > 3
        agreeing = _no_worse(wrong_m / _EDGE_M) if sized else _agreeing(-wrong_m / _EDGE_M)
        self._weigh(np.log(agreeing + _WRONG).sum(axis=1))
        return self._believable

    def _distances_m(self, points_m: Floats) -> Floats:
        """How far points (S, 2) are from the edge of the parcel at each pose, (N, S)."""
        yaw_rad = self._states[:, 2, None]
        cosine, sine = np.cos(yaw_rad), np.sin(yaw_rad)
        x_m, y_m = points_m.T[:, None] - self._states.T[:2, :, None]
        own_m = np.stack((cosine * x_m + sine * y_m, cosine * y_m - sine * x_m), axis=-1)
        # A larger parcel has the same distance as the drawn one from a point that much nearer.
        own_m -= np.sign(own_m) * self._states[:, None, 3:] if len(self._extents_m) > 3 else 0.0
        off_m = self._footprint.distance_m(own_m.reshape(-1, 2), np.zeros(3))
        return off_m.reshape(x_m.shape)

    def _weigh(self, log_likelihood: Floats) -> None:
        weights = self._weights * np.exp(log_likelihood - log_likelihood.max())
        self._weights = weights / weights.sum()
        if 1.0 / (self._weights**2).sum() < _COUNTING * self._count:
            self._draw_anew()

    def _draw_anew(self) -> None:
        spread = self.covariance - self._hidden
        deviations = np.linalg.cholesky(spread + _LEAST * np.eye(len(spread)))
        off = self._chance.normal(0.0, _KERNEL, self._states.shape) @ deviations.T
        off[:, self._hidden.diagonal() > 0.0] = 0.0
        self._states = self._states[self._drawn(self._weights)] + off
        self._weights = np.full(self._count, 1.0 / self._count)

    def _drawn(self, weights: Floats) -> Ints:
        """Numbers of poses, each as often as it counts."""
        steps = (np.arange(self._count) + 0.5) / self._count
        numbers = np.searchsorted(np.cumsum(weights) / weights.sum(), steps)
        return np.minimum(numbers, len(weights) - 1)


def _agreeing(deviations: Floats) -> Floats:
    """The share of a normal distribution below so many deviations, to a hundredth."""
    share: Floats = 0.5 * (1.0 + np.tanh(0.8 * deviations))
    return share


def _no_worse(deviations: Floats) -> Floats:
    """The density of a normal distribution so far above its middle, over that of the middle."""
    density: Floats = np.exp(-(np.maximum(deviations, 0.0) ** 2) / 2)
    return density
