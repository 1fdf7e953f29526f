"""Where a shape stands safely: on the table, with its centre of mass well inside its supports."""

from dataclasses import dataclass
from functools import cached_property
from math import ceil, hypot

import numpy as np

from mdms_host.layout import Layout
from mdms_host.motion.footing import INSET_M, MARGIN_M
from mdms_host.routes.shape import Shape
from mdms_host.routes.sweep import overhang_m
from mdms_model.arrays import Floats
from mdms_model.outline import polygon_outline
from mdms_model.statics.support_margin import support_margins_m

#: How far a corner moves from one pose that is checked to the next, at most [m].
_STEP_M = 0.005
#: A parcel that is nearer to tipping, or farther over the edge, at its start may go on so [m].
SLACK_M = 0.002
#: How far over the edge still counts as on the table: rounding [m].
_EDGE_M = 1e-6
#: Poses that stand for all: so many along each side of a cell, and so many yaws of a quarter turn.
_PLACES, _YAWS = 10, 12


@dataclass(frozen=True)
class Standing:
    """A shape on the wheels of a table."""

    layout: Layout
    shape: Shape

    def least_margin_m(self, start: Floats, end: Floats) -> float:
        """The least margin of the centre of mass on the straight way between two poses [m]."""
        return float(self._margins_m(_between(start, end, self.shape.bottom.reach_m)).min())

    def stands(self, start: Floats, end: Floats, need_m: float = MARGIN_M) -> bool:
        """Whether it stands safely all the straight way between two poses that are on the table."""
        if self.everywhere and need_m <= MARGIN_M and self.overhang_m(start, end) < _EDGE_M:
            return True
        return self.least_margin_m(start, end) >= need_m

    def overhang_m(self, start: Floats, end: Floats) -> float:
        """How far it hangs over the edge of the table at most on the straight way [m]."""
        half_x_m = self.layout.columns * self.layout.pitch_m / 2
        half_y_m = self.layout.rows * self.layout.pitch_m / 2
        return overhang_m(self.shape.body, start, end, half_x_m, half_y_m)

    @cached_property
    def everywhere(self) -> bool:
        """Whether it stands safely wherever it is on the table whole, by poses all over a cell."""
        pitch_m, reach_m = self.layout.pitch_m, self.shape.bottom.reach_m
        if min(self.layout.columns, self.layout.rows) * pitch_m < 2 * reach_m + pitch_m:
            return False
        middle_m = self.layout.cell_positions_m[
            (self.layout.rows // 2) * self.layout.columns + self.layout.columns // 2
        ]
        x_m, y_m = middle_m - np.sign(middle_m) * pitch_m / 2
        places_m = (np.arange(_PLACES) / _PLACES - 0.5) * pitch_m
        yaws_rad = np.arange(1 if self.shape.round else _YAWS) * (np.pi / 2 / _YAWS)
        grid = np.meshgrid(x_m + places_m, y_m + places_m, yaws_rad, indexing="ij")
        poses = np.column_stack([axis.ravel() for axis in grid])
        return bool(self._margins_m(poses).min() >= MARGIN_M + SLACK_M)

    def _margins_m(self, poses: Floats) -> Floats:
        wheel_m = self.layout.wheel_positions_m
        low_m = poses[:, :2].min(axis=0) - self.shape.bottom.reach_m
        high_m = poses[:, :2].max(axis=0) + self.shape.bottom.reach_m
        near = ((wheel_m >= low_m) & (wheel_m <= high_m)).all(axis=1)
        if near.sum() < 2:
            return np.full(len(poses), -np.inf)
        edges = self.shape.outline.edges
        distances_m = edges[:, 2] - INSET_M
        corners_m = edges[:, 3:5] * (1 - INSET_M / distances_m.min())
        outline = polygon_outline(corners_m)
        outline.edges[:, 2] = distances_m
        return support_margins_m(wheel_m[near], outline, self.shape.centre_of_mass_m, poses)


def _between(start: Floats, end: Floats, reach_m: float) -> Floats:
    """Poses of the straight way between two, shape (P, 3)."""
    way_m = hypot(end[0] - start[0], end[1] - start[1]) + abs(end[2] - start[2]) * reach_m
    shares = np.linspace(0.0, 1.0, max(ceil(way_m / _STEP_M), 1) + 1)
    poses: Floats = start + shares[:, None] * (end - start)
    return poses
