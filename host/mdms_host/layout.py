"""The array as the host believes it to be: where its wheels and sensors are, which node is which.

Cells are numbered from 1, along x first; wheels are ordered by cell, then by axis. The origin of
the table frame is the centre of the array.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mdms_model.array import cell_centres
from mdms_model.arrays import Floats, Ints
from mdms_model.scenario.scenario import Array
from mdms_protocol.codecs import cob

_SENSOR_OFFSETS_M = (
    (0.0, 0.0),
    (0.03175, 0.03175),
    (-0.03175, 0.03175),
    (-0.03175, -0.03175),
    (0.03175, -0.03175),
)


@dataclass(frozen=True, slots=True)
class WheelPlace:
    """A wheel within its cell: the direction it pushes along and its contact from the centre."""

    direction_rad: float
    offset_m: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Layout:
    """A grid of like cells; `node_ids` are those of cells 1, 2, ..., by default the same numbers.

    `buses` are those that the cells are on, numbered from 0, by default one for all. Raises
    ValueError when the grid is empty or node ids and buses do not fit it.
    """

    columns: int
    rows: int
    pitch_m: float = 0.127
    wheels: tuple[WheelPlace, ...] = (WheelPlace(0.0), WheelPlace(np.pi / 2))
    sensor_offsets_m: tuple[tuple[float, float], ...] = _SENSOR_OFFSETS_M
    node_ids: tuple[int, ...] = ()
    buses: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.columns < 1 or self.rows < 1 or not self.wheels:
            raise ValueError(
                f"an array needs columns, rows and wheels; got {self.columns} x {self.rows} cells "
                f"of {len(self.wheels)} wheels"
            )
        if not self.node_ids:
            object.__setattr__(self, "node_ids", tuple(range(1, self.cells + 1)))
        if not self.buses:
            object.__setattr__(self, "buses", (0,) * self.cells)
        addresses = {*zip(self.buses, self.node_ids, strict=False)}
        if {len(addresses), len(self.node_ids), len(self.buses)} != {self.cells}:
            raise ValueError(
                f"{self.cells} cells need as many different node ids, got {self.node_ids}"
                + (f" on buses {self.buses}" if any(self.buses) else "")
            )
        if {*self.buses} != {*range(self.bus_count)}:
            raise ValueError(f"buses are numbered from 0 without gaps, got {self.buses}")
        if not all(cob.NODE_MIN <= node <= cob.CELL_NODE_MAX for node in self.node_ids):
            raise ValueError(f"node ids must be 1 to 126, got {self.node_ids}")

    @property
    def cells(self) -> int:
        """How many cells there are."""
        return self.columns * self.rows

    @property
    def bus_count(self) -> int:
        """How many buses there are."""
        return max(self.buses) + 1

    @cached_property
    def cell_positions_m(self) -> Floats:
        """Centres of the cells [m; table frame], shape (cells, 2)."""
        return cell_centres(Array(self.columns, self.rows, self.pitch_m))

    @cached_property
    def wheel_positions_m(self) -> Floats:
        """Contact points of the wheels [m; table frame], shape (W, 2)."""
        offsets_m = np.array([wheel.offset_m for wheel in self.wheels], dtype=np.float64)
        places_m: Floats = self.cell_positions_m[:, None, :] + offsets_m
        return places_m.reshape(-1, 2)

    @cached_property
    def wheel_directions(self) -> Floats:
        """Unit vectors along which the wheels push [table frame], shape (W, 2)."""
        angles_rad = np.array([wheel.direction_rad for wheel in self.wheels])
        return np.tile(np.column_stack((np.cos(angles_rad), np.sin(angles_rad))), (self.cells, 1))

    @cached_property
    def wheel_cells(self) -> Ints:
        """Number of the cell that each wheel belongs to, from 1, shape (W,)."""
        return np.repeat(np.arange(1, self.cells + 1), len(self.wheels))

    @cached_property
    def sensor_positions_m(self) -> Floats:
        """Places of the presence sensors [m; table frame], shape (cells, sensors, 2)."""
        offsets_m = np.array(self.sensor_offsets_m, dtype=np.float64)
        places_m: Floats = self.cell_positions_m[:, None, :] + offsets_m
        return places_m

    @cached_property
    def sensors_m(self) -> Floats:
        """The same by cell in one row, shape (S, 2)."""
        return self.sensor_positions_m.reshape(-1, 2)

    @cached_property
    def sensor_cells(self) -> Ints:
        """Number of the cell that each of these belongs to, from 1, shape (S,)."""
        return np.repeat(np.arange(1, self.cells + 1), len(self.sensor_offsets_m))

    def surface_jacobian(self, x_m: float, y_m: float) -> Floats:
        """Matrix that maps a rigid twist (vx, vy, omega) about a point to speeds along the wheels.

        Shape (W, 3) [1, 1, m]; the point in m, table frame.
        """
        about_point = np.array([[1.0, 0.0, y_m], [0.0, 1.0, -x_m], [0.0, 0.0, 1.0]])
        jacobian: Floats = self._jacobian_about_origin @ about_point
        return jacobian

    @cached_property
    def _jacobian_about_origin(self) -> Floats:
        """Each wheel's direction and its moment about the origin [1, 1, m], shape (W, 3)."""
        (x_m, y_m), (along_x, along_y) = self.wheel_positions_m.T, self.wheel_directions.T
        return np.column_stack((along_x, along_y, along_y * x_m - along_x * y_m))
