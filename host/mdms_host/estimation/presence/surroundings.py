"""The sensors and wheels of the cells around a place, so that nothing looks at a whole table."""

from dataclasses import dataclass
from math import ceil, floor

import numpy as np

from mdms_host.layout import Layout
from mdms_model.arrays import Floats, Ints

#: So many are kept; parcels come through few cells at a time.
_KEPT = 512


@dataclass(frozen=True, slots=True)
class Near:
    """Numbers and places of N sensors and of V wheels, and the speeds that a twist gives them.

    `jacobian` maps a twist about the table's origin to the speeds of these wheels, shape (V, 3).
    """

    sensors: Ints
    sensors_m: Floats
    wheels: Ints
    wheels_m: Floats
    jacobian: Floats

    def surface_jacobian(self, pose: Floats) -> Floats:
        """The same for a twist about the place of a pose."""
        x_m, y_m, _ = pose.tolist()
        about_point = np.array([[1.0, 0.0, y_m], [0.0, 1.0, -x_m], [0.0, 0.0, 1.0]])
        jacobian: Floats = self.jacobian @ about_point
        return jacobian


class Surroundings:
    """Finds the cells near places of a layout."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._shape = layout.rows, layout.columns
        self._sensors_m = layout.sensors_m
        self._jacobian = layout.surface_jacobian(0.0, 0.0)
        offsets_m = [*layout.sensor_offsets_m, *(wheel.offset_m for wheel in layout.wheels)]
        self._offset_m = float(np.abs(offsets_m).max())
        self._kept: dict[tuple[int, int, int, int], Near] = {}

    def of(self, place_m: Floats, reach_m: float) -> Near:
        """All sensors and wheels within `reach_m` of a place (2,), and some more."""
        x_m, y_m = place_m.tolist()
        reach_m += self._offset_m
        rows, columns = self._shape
        key = (*self._span(y_m, reach_m, rows), *self._span(x_m, reach_m, columns))
        if key not in self._kept:
            if len(self._kept) >= _KEPT:
                self._kept.clear()
            self._kept[key] = self._cut(*key)
        return self._kept[key]

    def _span(self, place_m: float, reach_m: float, count: int) -> tuple[int, int]:
        """From which to which row or column cells lie within reach; none: the same twice."""
        middle, pitch_m = (count - 1) / 2, self._layout.pitch_m
        first = max(0, ceil((place_m - reach_m) / pitch_m + middle))
        last = min(count, floor((place_m + reach_m) / pitch_m + middle) + 1)
        return first, max(first, last)

    def _cut(self, bottom: int, top: int, left: int, right: int) -> Near:
        layout = self._layout
        cells = np.arange(layout.cells).reshape(self._shape)[bottom:top, left:right].ravel()
        sensors = _members(cells, len(layout.sensor_offsets_m))
        wheels = _members(cells, len(layout.wheels))
        return Near(
            sensors,
            self._sensors_m[sensors],
            wheels,
            layout.wheel_positions_m[wheels],
            self._jacobian[wheels],
        )


def _members(cells: Ints, each: int) -> Ints:
    members: Ints = (cells[:, None] * each + np.arange(each)).ravel()
    return members
