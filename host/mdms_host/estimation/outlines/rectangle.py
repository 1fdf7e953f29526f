"""A parcel's rectangular bottom seen from above, and how far points are from its edge."""

from dataclasses import dataclass
from functools import cached_property
from math import copysign, cos, hypot, pi, sin

import numpy as np

from mdms_host.estimation.outlines.bottom import local_m, turned_m
from mdms_model.arrays import Floats

_CORNERS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])


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
    def spans_m(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """From where to where it reaches, along its own x and y: as far as its corners [m]."""
        return (-self.reach_m, self.reach_m), (-self.reach_m, self.reach_m)

    @property
    def period_rad(self) -> float:
        """Turn after which the bottom looks the same [rad]."""
        return pi / 2 if self.length_m == self.width_m else pi

    def grown(self, along_m: float, across_m: float) -> "Rectangle":
        """The same, but larger by so much on either side, along its own x and y [m]."""
        return Rectangle(self.length_m + 2 * along_m, self.width_m + 2 * across_m)

    def outline_m(self, pose: Floats) -> Floats:
        """The corners of one pose [m; table frame], anticlockwise, shape (4, 2)."""
        return turned_m(_CORNERS * self._half_m, pose)

    def distance_m(self, points_m: Floats, pose: Floats) -> Floats:
        """Distance of points to the nearer edge line [m], negative inside, shape (S,).

        Outside a corner it is the greater of the two, not the Euclidean distance.
        """
        over_m = np.abs(local_m(points_m, pose)) - self._half_m
        nearer_m: Floats = np.maximum(over_m[:, 0], over_m[:, 1])
        return nearer_m

    def edge(self, point_m: Floats, pose: Floats) -> tuple[float, Floats]:
        """`distance_m` of one point, and its derivative by the pose [1, 1, m/rad], shape (3,)."""
        along_m, across_m = local_m(point_m, pose).tolist()
        over_m, beside_m = abs(along_m) - self.length_m / 2, abs(across_m) - self.width_m / 2
        cosine, sine = cos(pose[2]), sin(pose[2])
        if over_m >= beside_m:
            return over_m, copysign(1.0, along_m) * np.array([-cosine, -sine, across_m])
        return beside_m, copysign(1.0, across_m) * np.array([sine, -cosine, -along_m])

    def nearest_yaw_rad(self, yaw_rad: float, hint_rad: float) -> float:
        """The yaw that looks the same and is nearest to the hint [rad]."""
        return yaw_rad - self.period_rad * round((yaw_rad - hint_rad) / self.period_rad)

    def yaws_rad(self, hint_rad: float, step_rad: float) -> Floats:
        """Yaws that all look different, about the hint and some `step_rad` apart [rad], (Y,)."""
        steps = round(self.period_rad / step_rad)
        yaws_rad: Floats = hint_rad + self.period_rad * (np.arange(steps) / steps - 0.5)
        return yaws_rad

    def hidden(self, own_m: Floats, shown: Floats, along_m: Floats, across_m: Floats) -> Floats:
        """Sum of `shown` over the points inside, for each centre of a grid, shape (A, B).

        A point is inside where it is inside both ways, so the whole grid is one matrix product.
        """
        inside_along = np.abs(own_m[:, :1] - along_m) <= self.length_m / 2
        inside_across = np.abs(own_m[:, 1:] - across_m) <= self.width_m / 2
        total: Floats = (inside_along * shown[:, None]).T @ inside_across
        return total

    @cached_property
    def _half_m(self) -> Floats:
        return np.array([self.length_m, self.width_m]) / 2
