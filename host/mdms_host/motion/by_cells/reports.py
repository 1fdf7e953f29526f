"""The cells' reports of the parcels that they steer: identity, state, and missing programs."""

from collections.abc import Iterator
from math import pi

import numpy as np

from mdms_host.estimation.footprint import Bottom
from mdms_host.layout import Layout
from mdms_host.places import neighbours_of
from mdms_model.arrays import Floats
from mdms_protocol.neighbours import frames as wire
from mdms_protocol.neighbours.messages import Estimate

#: A cell at a parcel reports at every SYNC; a report counts for nothing after so long [s].
FRESH_S = 0.05
#: A parcel lies on a cell when one of its sensors is so deep under it by the host's estimate [m].
_DEEP_M = 0.01


class Reports:
    """The estimates that came last from the cells (numbers from 1) of a layout.

    Those that are `lost` are not expected to send any. All that is returned is as of `now_s`, the
    time of the last call of `age`.
    """

    def __init__(self, layout: Layout) -> None:
        self._neighbours = {
            number: tuple(neighbours_of(layout, number)) for number in range(1, layout.cells + 1)
        }
        self.lost: frozenset[int] = frozenset()
        self._sensors_m = layout.sensor_positions_m
        self._places_m = layout.cell_positions_m.tolist()
        self._last: dict[int, tuple[float, Estimate]] = {}

    def take(self, cell: int, estimate: Estimate, now_s: float) -> None:
        """A cell has sent an estimate."""
        self._last[cell] = now_s, estimate

    def age(self, now_s: float) -> None:
        """Drop reports that are too old."""
        self._last = {
            cell: (time_s, estimate)
            for cell, (time_s, estimate) in self._last.items()
            if now_s - time_s <= FRESH_S
        }

    def drop(self, identity: int) -> None:
        """Drop the reports of this identity: it was taken from the cells since."""
        self._last = {
            cell: (time_s, estimate)
            for cell, (time_s, estimate) in self._last.items()
            if estimate.identity != identity
        }

    def of(self, identity: int) -> dict[int, Estimate]:
        """The estimates of all cells that are at the parcel of this identity, by cell."""
        return {
            cell: estimate
            for cell, (_, estimate) in self._last.items()
            if estimate.identity == identity
        }

    def under(self, identity: int) -> dict[int, Estimate]:
        """The estimates of those of them that are under it."""
        return {
            cell: estimate
            for cell, estimate in self.of(identity).items()
            if estimate.state == wire.UNDER
        }

    def expected(self, bottom: Bottom, pose: Floats) -> set[int]:
        """The cells that a parcel lies on at a pose, so that they are to report it."""
        away_m = bottom.distance_m(self._sensors_m.reshape(-1, 2), pose)
        deep = (away_m.reshape(self._sensors_m.shape[:2]) < -_DEEP_M).any(axis=1)
        return {int(cell) + 1 for cell in np.flatnonzero(deep)} - self.lost

    def poses(self, identity: int) -> dict[int, tuple[float, float, float]]:
        """Where those under a parcel that have a pose of it believe it to be [table frame]."""
        return {
            cell: self._pose(cell, estimate)
            for cell, estimate in self.under(identity).items()
            if estimate.certainty
        }

    def _pose(self, cell: int, estimate: Estimate) -> tuple[float, float, float]:
        x_m, y_m = self._places_m[cell - 1]
        step_m = wire.STEP_UM * 1e-6
        turn_rad = 2 * pi / wire.TURN
        return x_m + estimate.x * step_m, y_m + estimate.y * step_m, estimate.yaw * turn_rad

    def have_arrived(self, identity: int) -> bool:
        """Whether most of the cells under a parcel report that it stands at its goal.

        Cells at its edge that have no pose of it have no say.
        """
        under = [each for each in self.under(identity).values() if each.certainty]
        arrived = sum(bool(estimate.flags & wire.ARRIVED) for estimate in under)
        return 2 * arrived > len(under)

    def held(self, identity: int) -> dict[int, set[int]]:
        """The cells that hold a parcel for want of promises, each with the cells it lacks."""
        under = self.under(identity)
        return {
            cell: set(self._lacked(cell, estimate))
            for cell, estimate in under.items()
            if estimate.hold == 0
        }

    def _lacked(self, cell: int, estimate: Estimate) -> Iterator[int]:
        """The neighbours that a cell wants, and that are not promised to its parcel."""
        for direction, neighbour in enumerate(self._neighbours[cell]):
            if not neighbour or not estimate.wants >> direction & 1:
                continue
            its = self.of(estimate.identity).get(neighbour)
            if its is None or its.state < wire.PROMISED:
                yield neighbour
