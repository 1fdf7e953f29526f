"""A parcel's bottom of straight edges seen from above: any convex polygon."""

from dataclasses import dataclass
from functools import cached_property
from math import cos, hypot, pi, sin

import numpy as np

from mdms_host.estimation.outlines.bottom import local_m, turned_m
from mdms_model.arrays import Floats
from mdms_model.outline import polygon_outline

#: Corners that come this near to others after a turn are taken for the same [m]: drawings give them
#: in whole millimetres, and no sensor at rest tells such poses apart.
_SAME_M = 0.002
#: How far beyond its corners a sensor may be that reads wrong, and the search goes on [m].
_SPARE_M = 0.02


@dataclass(frozen=True)
class Polygon:
    """The bottom of a parcel with these corners, counter-clockwise, in its own frame [m].

    Its centre is the frame's origin, which need not be the middle of the corners.
    """

    corners_m: tuple[tuple[float, float], ...]

    @cached_property
    def reach_m(self) -> float:
        """Distance of the farthest corner from the centre [m]."""
        return max(hypot(*corner) for corner in self.corners_m)

    @cached_property
    def spans_m(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """From where to where it reaches, along its own x and y, with some to spare [m]."""
        (low_x, low_y), (high_x, high_y) = np.min(self.corners_m, 0), np.max(self.corners_m, 0)
        return (low_x - _SPARE_M, high_x + _SPARE_M), (low_y - _SPARE_M, high_y + _SPARE_M)

    @cached_property
    def period_rad(self) -> float:
        """Turn after which the bottom looks the same; a whole one for most outlines [rad]."""
        corners = np.array(self.corners_m) @ (1.0, 1j)
        for parts in range(len(corners), 1, -1):
            away_m = np.abs(corners * np.exp(2j * pi / parts) - corners[:, None])
            if away_m.min(axis=0).max() < _SAME_M:
                return 2 * pi / parts
        return 2 * pi

    def grown(self, along_m: float, across_m: float) -> "Polygon":
        """The same, but larger by so much on either side, along its own x and y [m]."""
        half_m = np.ptp(self.corners_m, axis=0) / 2
        larger_m = np.array(self.corners_m) * (half_m + np.array([along_m, across_m])) / half_m
        return Polygon(tuple((x, y) for x, y in larger_m.tolist()))

    def outline_m(self, pose: Floats) -> Floats:
        """Its corners at a pose [m; table frame], anticlockwise, shape (N, 2)."""
        return turned_m(np.array(self.corners_m), pose)

    def distance_m(self, points_m: Floats, pose: Floats) -> Floats:
        """Distance of points (S, 2) to the nearest edge line [m], negative inside, shape (S,).

        Outside a corner it is the greatest of all, not the Euclidean distance.
        """
        over_m = local_m(points_m, pose) @ self._normals.T - self._distances_m
        nearest_m: Floats = over_m.max(axis=1)
        return nearest_m

    def edge(self, point_m: Floats, pose: Floats) -> tuple[float, Floats]:
        """`distance_m` of one point, and its derivative by the pose [1, 1, m/rad], shape (3,)."""
        own_m = local_m(point_m, pose)
        over_m = self._normals @ own_m - self._distances_m
        nearest = int(over_m.argmax())
        normal_x, normal_y = self._normals[nearest].tolist()
        cosine, sine = cos(pose[2]), sin(pose[2])
        slope = np.array(
            [
                sine * normal_y - cosine * normal_x,
                -sine * normal_x - cosine * normal_y,
                normal_x * own_m[1] - normal_y * own_m[0],
            ]
        )
        return float(over_m[nearest]), slope

    def nearest_yaw_rad(self, yaw_rad: float, hint_rad: float) -> float:
        """The yaw that looks the same and is nearest to the hint [rad]."""
        return yaw_rad - self.period_rad * round((yaw_rad - hint_rad) / self.period_rad)

    def yaws_rad(self, hint_rad: float, step_rad: float) -> Floats:
        """Yaws that all look different, about the hint and some `step_rad` apart [rad], (Y,)."""
        steps = round(self.period_rad / step_rad)
        yaws_rad: Floats = hint_rad + self.period_rad * (np.arange(steps) / steps - 0.5)
        return yaws_rad

    def hidden(self, own_m: Floats, shown: Floats, along_m: Floats, across_m: Floats) -> Floats:
        """Sum of `shown` over the points inside, for each centre of a grid, shape (A, B)."""
        inside = np.ones((len(own_m), len(along_m), len(across_m)), dtype=bool)
        for (normal_x, normal_y), distance_m in zip(self._normals, self._distances_m, strict=True):
            over_along_m = normal_x * (own_m[:, :1] - along_m) - distance_m
            over_across_m = normal_y * (own_m[:, 1:] - across_m)
            inside &= over_along_m[:, :, None] <= -over_across_m[:, None, :]
        total: Floats = np.tensordot(shown, inside, axes=1)
        return total

    @cached_property
    def _edges(self) -> Floats:
        return polygon_outline(np.array(self.corners_m)).edges

    @cached_property
    def _normals(self) -> Floats:
        return self._edges[:, :2]

    @cached_property
    def _distances_m(self) -> Floats:
        return self._edges[:, 2]
