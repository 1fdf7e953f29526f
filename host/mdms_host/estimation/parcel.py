"""A parcel as given to the host, a region where one is expected, and an exit of the table."""

from dataclasses import dataclass
from math import cos, sin

import numpy as np

from mdms_host.estimation.footprint import Disc, Footprint, Polygon, Rectangle
from mdms_model.arrays import Bools, Floats
from mdms_model.scenario.scenario import DRAWN_M

_DISC_CORNERS = 48


@dataclass(frozen=True, slots=True)
class Parcel:
    """A parcel as given to the host: its outline, and roughly where it was put.

    Of several parcels that have not been found each is sought first where it is nearest to
    `near_m`. The yaw starts as the one that looks the same and is nearest to `yaw_hint_rad`.
    `corners_m` are those of the shape 'polygon', in its own frame, and `length_m` is the diameter
    of a 'disc'. `spread_m` is how exact the outline is, on either side (one standard deviation).
    For a size that is to be learned it is some millimetres, and edges show the rest.
    """

    name: str
    length_m: float
    width_m: float
    near_m: tuple[float, float] | None = None
    yaw_hint_rad: float = 0.0
    shape: str = "rectangle"
    corners_m: tuple[tuple[float, float], ...] = ()
    spread_m: float = DRAWN_M

    @property
    def footprint(self) -> Footprint:
        """The outline that the wheels and sensors are under."""
        if self.shape == "disc":
            return Disc(self.length_m)
        if self.shape == "polygon":
            return Polygon(self.corners_m)
        return Rectangle(self.length_m, self.width_m)


def outline_corners_m(parcel: Parcel) -> tuple[tuple[float, float], ...]:
    """The corners of a parcel's outline in its own frame; a disc has many."""
    if parcel.shape == "polygon":
        return parcel.corners_m
    if parcel.shape == "disc":
        turns = np.linspace(0.0, 2 * np.pi, _DISC_CORNERS, endpoint=False)
        radius_m = parcel.length_m / 2
        return tuple((radius_m * cos(turn), radius_m * sin(turn)) for turn in turns.tolist())
    half_m = parcel.length_m / 2, parcel.width_m / 2
    return tuple((x * half_m[0], y * half_m[1]) for x, y in ((1, 1), (-1, 1), (-1, -1), (1, -1)))


@dataclass(frozen=True, slots=True)
class BoundingBox:
    """An upright rectangle of the table, from its least to its greatest x and y [m; table frame].

    An infeed is one: a parcel that is announced there is found nowhere else.
    """

    low_m: tuple[float, float]
    high_m: tuple[float, float]

    def holds(self, points_m: Floats) -> Bools:
        """Which of the points (N, 2) lie in it, shape (N,)."""
        beyond = (points_m < self.low_m) | (points_m > self.high_m)
        inside: Bools = np.logical_not(beyond.any(axis=1))
        return inside


@dataclass(frozen=True, slots=True)
class ExitLine:
    """A line through a point [m; table frame], square to the heading in which parcels leave [rad].

    A parcel has left once its centre is past the line: at an edge of the table, where it loses its
    support.
    """

    x_m: float
    y_m: float
    heading_rad: float

    def past_m(self, points_m: Floats) -> Floats:
        """How far points (..., 2) are past the line [m], negative before it, shape (...)."""
        outward = cos(self.heading_rad), sin(self.heading_rad)
        past_m: Floats = (points_m - (self.x_m, self.y_m)) @ outward
        return past_m

    def reached_by(self, footprint: Footprint, pose: Floats) -> bool:
        """Whether any of a parcel at this pose [m, m, rad; table frame] is past the line."""
        return bool(self.past_m(footprint.outline_m(pose)).max() >= 0.0)
