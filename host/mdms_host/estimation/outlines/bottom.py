"""A parcel's bottom from above: the interface of any outline to estimator and controller."""

from math import cos, sin
from typing import Protocol

import numpy as np

from mdms_model.arrays import Floats


class Bottom(Protocol):
    """A convex outline about the parcel's origin, its centre.

    A pose is (x, y, yaw) of the centre [m, m, rad; table frame], shape (3,).
    """

    @property
    def reach_m(self) -> float:
        """Distance of the farthest point from the centre [m]."""
        ...

    @property
    def spans_m(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """From where to where, along its own x and y, the search takes it to reach at most [m]."""
        ...

    @property
    def period_rad(self) -> float:
        """Turn after which the bottom looks the same [rad]."""
        ...

    def grown(self, along_m: float, across_m: float) -> "Bottom":
        """The same, but larger by so much on either side, along its own x and y [m]."""
        ...

    def outline_m(self, pose: Floats) -> Floats:
        """Corners of a polygon around it at a pose [m; table frame], anticlockwise, (N, 2)."""
        ...

    def distance_m(self, points_m: Floats, pose: Floats) -> Floats:
        """Distance of points (S, 2) to the nearest edge [m], negative inside, shape (S,)."""
        ...

    def edge(self, point_m: Floats, pose: Floats) -> tuple[float, Floats]:
        """`distance_m` of one point, and its derivative by the pose [1, 1, m/rad], shape (3,)."""
        ...

    def nearest_yaw_rad(self, yaw_rad: float, hint_rad: float) -> float:
        """The yaw that looks the same and is nearest to the hint [rad]."""
        ...

    def yaws_rad(self, hint_rad: float, step_rad: float) -> Floats:
        """Yaws that all look different, about the hint and some `step_rad` apart [rad], (Y,)."""
        ...

    def hidden(self, own_m: Floats, shown: Floats, along_m: Floats, across_m: Floats) -> Floats:
        """Sum of `shown` (S,) over the points inside, for each centre of a grid, shape (A, B).

        Points (S, 2) and the centres' coordinates (A,) and (B,) are along the parcel's own axes.
        """
        ...


def local_m(points_m: Floats, pose: Floats) -> Floats:
    """Points (..., 2) of the table in the frame of a parcel at a pose [m]."""
    x_m, y_m, yaw_rad = pose.tolist()
    cosine, sine = cos(yaw_rad), sin(yaw_rad)
    own_m: Floats = (points_m - (x_m, y_m)) @ np.array([[cosine, -sine], [sine, cosine]])
    return own_m


def turned_m(own_m: Floats, pose: Floats) -> Floats:
    """Points (..., 2) in the frame of a parcel, on the table at a pose [m; table frame]."""
    x_m, y_m, yaw_rad = pose.tolist()
    cosine, sine = cos(yaw_rad), sin(yaw_rad)
    places_m: Floats = own_m @ np.array([[cosine, sine], [-sine, cosine]]) + (x_m, y_m)
    return places_m
