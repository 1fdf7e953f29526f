"""A parcel's footprint as seen from above: a disc, a rectangle or a convex polygon.

`Footprint` is the interface of any footprint to estimator and controller.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import copysign, cos, hypot, pi, sin
from typing import Protocol

import numpy as np

from mdms_model import outline
from mdms_model.arrays import Floats


class Footprint(Protocol):
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
        """Turn after which the footprint looks the same [rad]."""
        ...

    def grown(self, along_m: float, across_m: float) -> "Footprint":
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
        return yaw_rad - self.period_rad * round((yaw_rad - hint_rad) / self.period_rad)

    def yaws_rad(self, hint_rad: float, step_rad: float) -> Floats:
        """Yaws that all look different, about the hint and some `step_rad` apart [rad], (Y,)."""
        steps = round(self.period_rad / step_rad)
        yaws_rad: Floats = hint_rad + self.period_rad * (np.arange(steps) / steps - 0.5)
        return yaws_rad

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


_ANGLES = np.arange(32) * (2 * pi / 32)
#: Corners of a polygon around the unit circle.
_AROUND = np.column_stack((np.cos(_ANGLES), np.sin(_ANGLES))) / np.cos(pi / 32)


@dataclass(frozen=True)
class Disc:
    """The bottom of a round parcel. Its yaw is carried on by the wheels alone: no edge shows it."""

    diameter_m: float

    @property
    def reach_m(self) -> float:
        """Distance of the rim from the centre [m]."""
        return self.diameter_m / 2

    @property
    def spans_m(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """From where to where it reaches, along x and y [m]."""
        return (-self.reach_m, self.reach_m), (-self.reach_m, self.reach_m)

    @property
    def period_rad(self) -> float:
        """A whole turn, although any other looks the same as well [rad]."""
        return 2 * pi

    def grown(self, along_m: float, across_m: float) -> "Disc":
        """The same disc, larger by so much on either side, along its own x and y [m].

        It stays round: it grows by the mean of both.
        """
        return Disc(self.diameter_m + along_m + across_m)

    def outline_m(self, pose: Floats) -> Floats:
        """Corners of a polygon around it at a pose [m; table frame], anticlockwise, (32, 2)."""
        return turned_m(_AROUND * self.reach_m, pose)

    def distance_m(self, points_m: Floats, pose: Floats) -> Floats:
        """Distance of points (S, 2) from the rim [m], negative inside, shape (S,)."""
        away_m = points_m - pose[:2]
        return np.hypot(away_m[:, 0], away_m[:, 1]) - self.reach_m

    def edge(self, point_m: Floats, pose: Floats) -> tuple[float, Floats]:
        """`distance_m` of one point, and its derivative by the pose, shape (3,)."""
        x_m, y_m = (point_m - pose[:2]).tolist()
        from_centre_m = hypot(x_m, y_m)
        outward = max(from_centre_m, 1e-9)
        return from_centre_m - self.reach_m, np.array([-x_m / outward, -y_m / outward, 0.0])

    def nearest_yaw_rad(self, yaw_rad: float, hint_rad: float) -> float:
        """The hint itself: all yaws look the same [rad]."""
        return hint_rad

    def yaws_rad(self, hint_rad: float, step_rad: float) -> Floats:
        """The hint alone [rad], shape (1,)."""
        return np.array([hint_rad])

    def hidden(self, own_m: Floats, shown: Floats, along_m: Floats, across_m: Floats) -> Floats:
        """Sum of `shown` over the points inside, for each centre of a grid, shape (A, B)."""
        along_m2 = (own_m[:, :1] - along_m) ** 2
        across_m2 = (own_m[:, 1:] - across_m) ** 2
        inside = along_m2[:, :, None] + across_m2[:, None, :] <= self.reach_m**2
        total: Floats = np.tensordot(shown, inside, axes=1)
        return total


_CORNERS = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])


@dataclass(frozen=True)
class Rectangle(Footprint):
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
        """Turn after which the footprint looks the same [rad]."""
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


#: Corners that come this near to others after a turn are taken for the same [m]: drawings give them
#: in whole millimetres, and no sensor at rest tells such poses apart.
_SAME_M = 0.002
#: How far beyond its corners a sensor may be that reads wrong, and the search goes on [m].
_SPARE_M = 0.02


@dataclass(frozen=True)
class Polygon(Footprint):
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
        """Turn after which the footprint looks the same; a whole one for most outlines [rad]."""
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
        return outline.polygon_outline(np.array(self.corners_m)).edges

    @cached_property
    def _normals(self) -> Floats:
        return self._edges[:, :2]

    @cached_property
    def _distances_m(self) -> Floats:
        return self._edges[:, 2]


def edge_of(footprint: Footprint, point_m: Floats, pose: Floats) -> tuple[float, Floats]:
    """Distance of a point from the edge [m], and its derivative by pose and growth, (5,)."""
    off_m, slope = footprint.edge(point_m, pose)
    x, y, _ = slope.tolist()
    cosine, sine = cos(pose[2]), sin(pose[2])
    along, across = cosine * x + sine * y, cosine * y - sine * x
    return off_m, np.array([*slope, -along * along, -across * across])


#: Shares of a shift at which it is looked how near another parcel is.
_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
#: Room that a parcel needs around it to turn on the spot [m].
_NEAR_M = 0.015


def gap_m(one: Footprint, one_pose: Floats, other: Footprint, other_pose: Floats) -> float:
    """Gap between two parcels' outlines along the direction that parts them best [m]."""
    return outline.gap_m(one.outline_m(one_pose), other.outline_m(other_pose))


def has_room(
    name: str, move: Floats, places: Mapping[str, Floats], outlines: Mapping[str, Footprint]
) -> bool:
    """Whether a parcel may move so, turned anyhow, without coming near any other with a place.

    Beside another it may be shifted so that it comes no nearer to that.
    """
    mine = places[name]
    reach_m = outlines[name].reach_m + _NEAR_M + hypot(*move[:2].tolist())
    near = [
        other
        for other, place in places.items()
        if other != name and hypot(*(place - mine)[:2].tolist()) < reach_m + outlines[other].reach_m
    ]
    if move[2]:
        return not near
    return all(
        np.diff(
            [
                gap_m(outlines[name], mine + share * move, outlines[other], places[other])
                for share in _SHARES
            ]
        ).min()
        >= 0.0
        for other in near
    )
