"""A parcel's rectangular bottom seen from above, and how far points are from its edge."""

from dataclasses import dataclass
from functools import cached_property
from math import copysign, cos, hypot, pi, sin

import numpy as np

from mdms_model.arrays import Floats


@dataclass(frozen=True)
class Rectangle:
    """The bottom of a parcel: `length_m` along its own x, `width_m` along its own y.

    A pose is (x, y, yaw) of its centre [m, m, rad; table frame], shape (..., 3).
    """

    length_m: float
    width_m: float

    @cached_property
    def reach_m(self) -> float:
        """Distance of the corners from the centre [m]."""
        return hypot(self.length_m, self.width_m) / 2

    @property
    def period_rad(self) -> float:
        """Turn after which the bottom looks the same [rad]."""
        return pi / 2 if self.length_m == self.width_m else pi

    def local(self, points_m: Floats, pose: Floats) -> Floats:
        """Points of shape (..., 2) in the parcel's own frame [m], for one pose."""
        x_m, y_m, yaw_rad = pose.tolist()
        cosine, sine = cos(yaw_rad), sin(yaw_rad)
        own_m: Floats = (points_m - (x_m, y_m)) @ np.array([[cosine, -sine], [sine, cosine]])
        return own_m

    def distance_m(self, points_m: Floats, pose: Floats) -> Floats:
        """Distance of points to the nearer edge line [m], negative inside, shape (S,).

        Outside a corner it is the greater of the two, not the Euclidean distance.
        """
        over_m = np.abs(self.local(points_m, pose)) - self._half_m
        nearer_m: Floats = np.maximum(over_m[:, 0], over_m[:, 1])
        return nearer_m

    def edge(self, point_m: Floats, pose: Floats) -> tuple[float, Floats]:
        """`distance_m` of one point, and its derivative by the pose [1, 1, m/rad], shape (3,)."""
        along_m, across_m = self.local(point_m, pose).tolist()
        over_m, beside_m = abs(along_m) - self.length_m / 2, abs(across_m) - self.width_m / 2
        cosine, sine = cos(pose[2]), sin(pose[2])
        if over_m >= beside_m:
            return over_m, copysign(1.0, along_m) * np.array([-cosine, -sine, across_m])
        return beside_m, copysign(1.0, across_m) * np.array([sine, -cosine, -along_m])

    def nearest_yaw_rad(self, yaw_rad: float, hint_rad: float) -> float:
        """The yaw that looks the same and is nearest to the hint [rad]."""
        return yaw_rad - self.period_rad * round((yaw_rad - hint_rad) / self.period_rad)

    @cached_property
    def _half_m(self) -> Floats:
        return np.array([self.length_m, self.width_m]) / 2
