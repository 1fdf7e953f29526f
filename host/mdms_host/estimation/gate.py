"""An exit of the table: the line across which a parcel leaves it."""

from dataclasses import dataclass
from math import cos, sin

from mdms_host.estimation.outlines.bottom import Bottom
from mdms_model.arrays import Floats


@dataclass(frozen=True, slots=True)
class Gate:
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

    def reached_by(self, bottom: Bottom, pose: Floats) -> bool:
        """Whether any of a parcel at this pose [m, m, rad; table frame] is past the line."""
        return bool(self.past_m(bottom.outline_m(pose)).max() >= 0.0)
