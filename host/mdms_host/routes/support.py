"""The shape of a parcel for the planner, and where it stands safely.

A shape is half-planes about its centre. It stands if its centre of mass is well inside its
supports."""

from dataclasses import dataclass
from functools import cached_property
from math import ceil, hypot, pi

import numpy as np

from mdms_host.estimation.footprint import Disc, Footprint
from mdms_host.layout import Layout
from mdms_host.motion.footholds import INSET_M, MARGIN_M
from mdms_host.routes.sweep import Body, overhangs_m
from mdms_model.arrays import Floats
from mdms_model.outline import Outline, polygon_outline
from mdms_model.statics.support_margin import Contacts, contacts, margins_m

_QUARTER_RAD = pi / 2


@dataclass(frozen=True)
class Shape:
    """A footprint, and its centre of mass in its own frame; equal ones are planned alike."""

    footprint: Footprint
    centre_of_mass_m: tuple[float, float] = (0.0, 0.0)

    @property
    def round(self) -> bool:
        """Whether all yaws look the same, so that it is never turned."""
        return isinstance(self.footprint, Disc)

    @cached_property
    def body(self) -> Body:
        """The outline for `sweep.swept`."""
        normals, distances_m = self.outline.edges[:, :2], self.outline.edges[:, 2]
        corners_m = np.ascontiguousarray(self.outline.edges[:, 3:5])
        bend_m = 0.0 if self.round else self.footprint.reach_m
        return Body(np.ascontiguousarray(normals), distances_m.copy(), corners_m, bend_m)

    @cached_property
    def outline(self) -> Outline:
        """The outline, a polygon around a disc's."""
        return polygon_outline(self.footprint.outline_m(np.zeros(3)))

    @property
    def period_rad(self) -> float:
        """The turn after which it lies as before, and its centre of mass too."""
        return 2 * pi if any(self.centre_of_mass_m) else self.footprint.period_rad

    @property
    def quarters(self) -> int:
        """How many quarter turns differ: 1 for discs and squares, 2 for boxes, up to 4."""
        if self.round:
            return 1
        turns = self.footprint.period_rad / _QUARTER_RAD
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


#: How far a corner moves from one pose that is checked to the next, at most [m]: a wheel
#: that supports it by `INSET_M` at the one still does halfway to the next.
_STEP_M = 2 * INSET_M
#: A parcel that is nearer to tipping, or farther over the edge, at its start may go on so [m].
SLACK_M = 0.002


@dataclass(frozen=True)
class ShapeSupport:
    """A shape on the wheels of a table.

    It stands at a pose if it does not tip `off_m` beside it. Where that is 0, its centre of mass is
    to be `MARGIN_M` inside its supports.
    """

    layout: Layout
    shape: Shape
    off_m: float = 0.0

    @property
    def need_m(self) -> float:
        """How far its centre of mass has to be inside its supports [m]."""
        return self.off_m or MARGIN_M

    def least_margin_m(self, start: Floats, end: Floats) -> float:
        """The least margin of the centre of mass on the straight way between two poses [m]."""
        poses = _between(start, end, self.shape.footprint.reach_m)
        return float(margins_m(self._contacts, poses).min())

    def stands(self, start: Floats, end: Floats, need_m: float | None = None) -> bool:
        """Whether it stands safely all the straight way between two poses that are on the table."""
        return self.least_margin_m(start, end) >= (self.need_m if need_m is None else need_m)

    def overhangs_m(self, starts: Floats, ends: Floats) -> Floats:
        """How far it hangs over the edge of the table at most on straight ways (M, 3), (M,)."""
        half_x_m = self.layout.columns * self.layout.pitch_m / 2
        half_y_m = self.layout.rows * self.layout.pitch_m / 2
        return overhangs_m(self.shape.body, starts, ends, half_x_m, half_y_m)

    @cached_property
    def _contacts(self) -> Contacts:
        """The wheels of the table under an outline that is inset."""
        edges = self.shape.outline.edges
        inset_m = max(INSET_M, self.off_m)
        distances_m = edges[:, 2] - inset_m
        corners_m = edges[:, 3:5] * (1 - inset_m / distances_m.min())
        outline = polygon_outline(corners_m)
        outline.edges[:, 2] = distances_m
        return contacts(self.layout.wheel_positions_m, outline, self.shape.centre_of_mass_m)


def _between(start: Floats, end: Floats, reach_m: float) -> Floats:
    """Poses of the straight way between two, shape (P, 3)."""
    way_m = hypot(end[0] - start[0], end[1] - start[1]) + abs(end[2] - start[2]) * reach_m
    steps = max(ceil(way_m / _STEP_M), 1)
    shares = np.arange(steps + 1) / steps
    poses: Floats = start + shares[:, None] * (end - start)
    return poses
