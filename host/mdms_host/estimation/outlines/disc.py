"""A parcel's round bottom seen from above; how it is turned cannot be seen."""

from dataclasses import dataclass
from math import hypot, pi

import numpy as np

from mdms_host.estimation.outlines.bottom import turned_m
from mdms_model.arrays import Floats

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
