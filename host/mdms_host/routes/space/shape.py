"""A parcel's outline as the planner takes it: half-planes about its centre, and how it may turn."""

from dataclasses import dataclass
from functools import cached_property
from math import pi

import numpy as np

from mdms_host.estimation.footprint import Bottom, Disc
from mdms_host.routes.space.sweep import Body
from mdms_model.outline import Outline, polygon_outline

_QUARTER_RAD = pi / 2


@dataclass(frozen=True)
class Shape:
    """A bottom and where its centre of mass is, in its own frame; equal ones are planned alike."""

    bottom: Bottom
    centre_of_mass_m: tuple[float, float] = (0.0, 0.0)

    @property
    def round(self) -> bool:
        """Whether all yaws look the same, so that it is never turned."""
        return isinstance(self.bottom, Disc)

    @cached_property
    def body(self) -> Body:
        """The outline for `sweep.swept`."""
        normals, distances_m = self.outline.edges[:, :2], self.outline.edges[:, 2]
        corners_m = np.ascontiguousarray(self.outline.edges[:, 3:5])
        bend_m = 0.0 if self.round else self.bottom.reach_m
        return Body(np.ascontiguousarray(normals), distances_m.copy(), corners_m, bend_m)

    @cached_property
    def outline(self) -> Outline:
        """The outline, a polygon around a disc's."""
        return polygon_outline(self.bottom.outline_m(np.zeros(3)))

    @property
    def period_rad(self) -> float:
        """The turn after which it lies as before, and its centre of mass too."""
        return 2 * pi if any(self.centre_of_mass_m) else self.bottom.period_rad

    @property
    def quarters(self) -> int:
        """How many quarter turns differ: 1 for discs and squares, 2 for boxes, up to 4."""
        if self.round:
            return 1
        turns = self.bottom.period_rad / _QUARTER_RAD
        return round(turns) if abs(turns - round(turns)) < 1e-9 else 4

    def yaws_rad(self, start_rad: float, goal_rad: float) -> list[float]:
        """Yaws of the lattice between a start and a goal that is at most half a turn away.

        They are multiples of a right angle, the nearest to both and all between, and at least both
        ways to lie. A disc has the yaw of the start alone.
        """
        if self.round:
            return [start_rad]
        first, last = sorted((round(start_rad / _QUARTER_RAD), round(goal_rad / _QUARTER_RAD)))
        if self.quarters > 1 and first == last:
            lies_back = start_rad < first * _QUARTER_RAD
            first, last = (first - 1, last) if lies_back else (first, last + 1)
        return [quarter * _QUARTER_RAD for quarter in range(first, last + 1)]
