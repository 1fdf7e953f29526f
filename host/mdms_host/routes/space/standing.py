"""Where a shape stands safely: on the table, with its centre of mass well inside its supports."""

from dataclasses import dataclass
from functools import cached_property
from math import ceil, hypot

import numpy as np

from mdms_host.layout import Layout
from mdms_host.motion.footholds import INSET_M, MARGIN_M
from mdms_host.routes.space.shape import Shape
from mdms_host.routes.space.sweep import overhangs_m
from mdms_model.arrays import Floats
from mdms_model.outline import polygon_outline
from mdms_model.statics.support_margin import Contacts, contacts, margins_m

#: How far a corner moves from one pose that is checked to the next, at most [m]: a wheel
#: that supports it by `INSET_M` at the one still does halfway to the next.
_STEP_M = 2 * INSET_M
#: A parcel that is nearer to tipping, or farther over the edge, at its start may go on so [m].
SLACK_M = 0.002


@dataclass(frozen=True)
class Standing:
    """A shape on the wheels of a table."""

    layout: Layout
    shape: Shape

    def least_margin_m(self, start: Floats, end: Floats) -> float:
        """The least margin of the centre of mass on the straight way between two poses [m]."""
        poses = _between(start, end, self.shape.bottom.reach_m)
        return float(margins_m(self._contacts, poses).min())

    def stands(self, start: Floats, end: Floats, need_m: float = MARGIN_M) -> bool:
        """Whether it stands safely all the straight way between two poses that are on the table."""
        return self.least_margin_m(start, end) >= need_m

    def overhangs_m(self, starts: Floats, ends: Floats) -> Floats:
        """How far it hangs over the edge of the table at most on straight ways (M, 3), (M,)."""
        half_x_m = self.layout.columns * self.layout.pitch_m / 2
        half_y_m = self.layout.rows * self.layout.pitch_m / 2
        return overhangs_m(self.shape.body, starts, ends, half_x_m, half_y_m)

    @cached_property
    def _contacts(self) -> Contacts:
        """The wheels of the table under an outline that is inset."""
        edges = self.shape.outline.edges
        distances_m = edges[:, 2] - INSET_M
        corners_m = edges[:, 3:5] * (1 - INSET_M / distances_m.min())
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
