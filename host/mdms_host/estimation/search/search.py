"""The search for a parcel that is not found, by its sensors; those of one cell may all be wrong.

A search takes some milliseconds, so each step makes one: first with all sensors, then, where some
contradict, without one cell after another.
"""

import numpy as np

from mdms_host.estimation.outlines.bottom import Bottom
from mdms_host.estimation.search.locate import Location, locate
from mdms_host.layout import Layout
from mdms_model.arrays import Bools

#: A place that leaves more of the covered sensors unexplained is not believed.
_DOUBTFUL_SHARE = 0.2
#: So many contradictions may be of one cell that is all wrong, if as many are gone without it.
_SUSPICIOUS = 3
#: A parcel tips if its centre of mass is beyond all wheels. The centre of mass lies at most this
#: far from the middle of the outline's corners [m].
_BESIDE_MIDDLE_M = 0.05


class Search:
    """A search for one parcel, from the sensors (S,) as they were when it began.

    `over` once there is nothing left to try: then `found` has the place, or None, and `left_out`
    the sensors (S,) of a cell that contradicts it.
    """

    def __init__(
        self, bottom: Bottom, layout: Layout, covered: Bools, mine: Bools, yaw_hint_rad: float
    ) -> None:
        self.covered = covered
        self.found: Location | None = None
        self.left_out: Bools = np.zeros(len(covered), dtype=bool)
        self.over = False
        self._bottom = bottom
        self._sensors_m = layout.sensors_m
        wheels_m = layout.wheel_positions_m
        # The origin of a polygon may lie beside the middle of its corners.
        middle_m = bottom.outline_m(np.zeros(3)).mean(axis=0)
        beyond_m = _BESIDE_MIDDLE_M + float(np.hypot(*middle_m))
        low_m, high_m = wheels_m.min(axis=0), wheels_m.max(axis=0)
        self._within_m = np.array((low_m - beyond_m, high_m + beyond_m))
        self._cell = layout.sensor_cells
        self._mine = mine
        self._yaw_hint_rad = yaw_hint_rad
        self._suspects: list[int] | None = None

    def step(self) -> None:
        """Try once more."""
        if self._suspects is None:
            self.found = self._locate(self._mine)
            well = self.found is not None and self.found.contradictions < _SUSPICIOUS
            self._suspects = [] if well else self._near()
        else:
            self._leave_out(self._cell == self._suspects.pop())
        if not self._suspects:
            self._conclude()

    def _locate(self, mine: Bools) -> Location | None:
        return locate(
            self._bottom,
            self._sensors_m[mine],
            self.covered[mine],
            self._yaw_hint_rad,
            self._within_m,
        )

    def _near(self) -> list[int]:
        """Cells that may lie under the parcel, or show something where it is not."""
        shown = self.covered & self._mine
        if not shown.any():
            return []
        away_m = self._sensors_m - np.median(self._sensors_m[shown], axis=0)
        near = shown | (np.hypot(away_m[:, 0], away_m[:, 1]) < self._bottom.reach_m)
        return [int(cell) for cell in np.unique(self._cell[near & self._mine])]

    def _leave_out(self, cell: Bools) -> None:
        """Take the place without a cell if it explains enough more."""
        found = self._locate(self._mine & ~cell)
        if found is None:
            return
        gone = 1 if self.left_out.any() else _SUSPICIOUS
        if self.found is None or found.contradictions + gone <= self.found.contradictions:
            self.found, self.left_out = found, cell

    def _conclude(self) -> None:
        self.over = True
        shown = self.covered & self._mine & ~self.left_out
        if self.found and self.found.contradictions > _DOUBTFUL_SHARE * shown.sum():
            self.found = None
