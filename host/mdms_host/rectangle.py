"""A parcel's rectangular bottom seen from above, and how far points are from its edge."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Rectangle:
    """The bottom of a parcel: `length_m` along its own x, `width_m` along its own y.

    A pose is (x, y, yaw) of its centre [m, m, rad; table frame], shape (..., 3).
    """

    length_m: float
    width_m: float

    @property
    def reach_m(self) -> float:
        """Distance of the corners from the centre [m]."""
        return float(np.hypot(self.length_m, self.width_m)) / 2

    @property
    def period_rad(self) -> float:
        """Turn after which the bottom looks the same [rad]."""
        return np.pi / 2 if self.length_m == self.width_m else np.pi

    def local(self, points_m: Floats, pose: Floats) -> Floats:
        """Points of shape (S, 2) in the parcel's own frame [m], for one pose."""
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        own_m: Floats = (points_m - pose[:2]) @ np.array([[cos, -sin], [sin, cos]])
        return own_m

    def distance_m(self, points_m: Floats, pose: Floats) -> Floats:
        """Distance of points to the nearer edge line [m], negative inside, shape (S,).

        Outside a corner it is the greater of the two, not the Euclidean distance.
        """
        over_m: Floats = np.abs(self.local(points_m, pose)) - self._half_m
        return np.asarray(over_m.max(axis=1))

    def distance_gradient(self, points_m: Floats, pose: Floats) -> Floats:
        """Derivative of `distance_m` by the pose [1, 1, m/rad], shape (S, 3)."""
        own_m = self.local(points_m, pose)
        side = np.argmax(np.abs(own_m) - self._half_m, axis=1)
        rows = np.arange(len(points_m))
        sign = np.sign(own_m[rows, side])
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        normal = sign[:, None] * np.array([[cos, sin], [-sin, cos]])[side]
        turn_m = sign * np.where(side == 0, own_m[:, 1], -own_m[:, 0])
        return np.column_stack((-normal, turn_m))

    def nearest_yaw_rad(self, yaw_rad: float, hint_rad: float) -> float:
        """The yaw that looks the same and is nearest to the hint [rad]."""
        return yaw_rad - self.period_rad * round((yaw_rad - hint_rad) / self.period_rad)

    @property
    def _half_m(self) -> Floats:
        return np.array([self.length_m, self.width_m]) / 2
