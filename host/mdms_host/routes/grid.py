"""The table as a grid: tiles that one parcel at a time may be on, and the poses of a shape."""

from dataclasses import dataclass
from functools import cached_property
from math import ceil

import numpy as np

from mdms_host.layout import Layout
from mdms_host.routes.support import Shape
from mdms_host.routes.sweep import Body, Sweeps, sweeps, swept
from mdms_model.arrays import Floats, Ints

#: Parcels that hang over the edge are on tiles of a rim this wide, unless it is given [m].
RIM_M = 0.05


@dataclass(frozen=True)
class Tiles:
    """Squares of a cell's pitch over `per_pitch`, and a rim of such squares around the table.

    They are numbered along x first, the rim's included. Raises ValueError for no whole number of
    squares a cell.
    """

    layout: Layout
    per_pitch: int = 2
    rim_m: float = RIM_M

    def __post_init__(self) -> None:
        if self.per_pitch < 1:
            raise ValueError(f"a cell has 1 or more tiles along its side, got {self.per_pitch}")

    @property
    def side_m(self) -> float:
        """Side of a tile [m]."""
        return self.layout.pitch_m / self.per_pitch

    @cached_property
    def rim(self) -> int:
        """How many tiles the rim is wide."""
        return ceil(self.rim_m / self.side_m)

    @cached_property
    def columns(self) -> int:
        """Tiles along x, the rim's included."""
        return self.layout.columns * self.per_pitch + 2 * self.rim

    @cached_property
    def rows(self) -> int:
        """Tiles along y, the rim's included."""
        return self.layout.rows * self.per_pitch + 2 * self.rim

    @property
    def count(self) -> int:
        """How many tiles there are."""
        return self.columns * self.rows

    @cached_property
    def half_table_m(self) -> tuple[float, float]:
        """From the table's middle to its edge along x and along y [m]."""
        layout = self.layout
        return layout.columns * layout.pitch_m / 2, layout.rows * layout.pitch_m / 2

    @cached_property
    def corner_m(self) -> tuple[float, float]:
        """The corner of tile 0 from which x and y rise [m; table frame]."""
        half_x_m, half_y_m = self.half_table_m
        return -half_x_m - self.rim * self.side_m, -half_y_m - self.rim * self.side_m

    def of_cell(self, number: int) -> Ints:
        """The tiles of a cell, numbered from 1, shape (per_pitch**2,)."""
        row, column = divmod(number - 1, self.layout.columns)
        own = np.arange(self.per_pitch)
        columns = self.rim + column * self.per_pitch + own
        rows = self.rim + row * self.per_pitch + own
        return (rows[:, None] * self.columns + columns).ravel()

    def cell_of(self, tile: int) -> int | None:
        """The cell, from 1, that a tile is on; None on the rim."""
        row, column = divmod(tile, self.columns)
        row, column = (row - self.rim) // self.per_pitch, (column - self.rim) // self.per_pitch
        layout = self.layout
        on_table = 0 <= row < layout.rows and 0 <= column < layout.columns
        return row * layout.columns + column + 1 if on_table else None

    def centre_m(self, tile: int) -> tuple[float, float]:
        """The middle of a tile [m; table frame]."""
        row, column = divmod(tile, self.columns)
        x_m, y_m = self.corner_m
        return x_m + (column + 0.5) * self.side_m, y_m + (row + 0.5) * self.side_m

    def swept(self, body: Body, starts: Floats, ends: Floats, grown_m: float) -> Sweeps:
        """The tiles that an outline meets on straight ways (M, 3) [table frame], grown by so much.

        Those beyond the rim are left out.
        """
        grid = self.side_m, self.columns, self.rows
        return sweeps(body, self.moved(starts), self.moved(ends), grown_m, grid)

    def moved(self, poses: Floats) -> Floats:
        """Poses in the frame whose origin is the corner of tile 0, shape (..., 3) as given."""
        moved: Floats = poses - np.array([*self.corner_m, 0.0])
        return moved


#: Columns and rows to the next place along each of eight lines, counterclockwise from +x.
LINES = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))
STRAIGHTS = len(LINES)


@dataclass(frozen=True)
class Lattice:
    """Places `step` tiles apart, at each of these yaws, where an outline covers the fewest tiles.

    Nodes are numbered by yaw, then row, then column. A place is a tile and an offset from its
    corner, so that the same tiles around it are met wherever it is.
    """

    tiles: Tiles
    shape: Shape
    yaws_rad: tuple[float, ...]
    step: int
    clearance_m: float

    @cached_property
    def columns(self) -> int:
        """Places along x."""
        return self.tiles.layout.columns * self.tiles.per_pitch // self.step

    @cached_property
    def rows(self) -> int:
        """Places along y."""
        return self.tiles.layout.rows * self.tiles.per_pitch // self.step

    @cached_property
    def places(self) -> int:
        """Nodes of one yaw."""
        return self.columns * self.rows

    @cached_property
    def count(self) -> int:
        """How many nodes there are."""
        return self.places * len(self.yaws_rad)

    @cached_property
    def offsets_m(self) -> Floats:
        """From the corner of a place's tile to the place, by yaw, shape (yaws, 2)."""
        side_m = self.tiles.side_m
        choices = [np.array([x, y]) * side_m / 2 for x in (1, 0) for y in (1, 0)]
        best = [min(choices, key=lambda at: self._tiles_at(at, yaw)) for yaw in self.yaws_rad]
        return np.array(best)

    def _tiles_at(self, offset_m: Floats, yaw_rad: float) -> int:
        pose = np.array([*offset_m, yaw_rad])
        return len(swept(self.shape.body, pose, pose, self.clearance_m, self.tiles.side_m).enters)

    @cached_property
    def bases(self) -> Ints:
        """The tile of every node, shape (count,)."""
        rim, step = self.tiles.rim, self.step
        columns = rim + np.arange(self.columns) * step
        rows = rim + np.arange(self.rows) * step
        places = (rows[:, None] * self.tiles.columns + columns).ravel()
        return np.tile(places, len(self.yaws_rad))

    @cached_property
    def poses(self) -> Floats:
        """The poses of all nodes [table frame], shape (count, 3)."""
        rows, columns = np.divmod(self.bases, self.tiles.columns)
        corner_m = np.column_stack((columns, rows)) * self.tiles.side_m + self.tiles.corner_m
        places_m = corner_m + np.repeat(self.offsets_m, self.places, axis=0)
        return np.column_stack((places_m, np.repeat(self.yaws_rad, self.places)))

    def near(self, pose: Floats, window: int, turn_rad: float) -> Ints:
        """Nodes about a pose: the nearest `window` along x and y, at yaws within `turn_rad`."""
        nodes: list[int] = []
        step_m = self.step * self.tiles.side_m
        for index, yaw_rad in enumerate(self.yaws_rad):
            if abs(yaw_rad - pose[2]) > turn_rad and not self.shape.round:
                continue
            origin_m = self.poses[index * self.places, :2]
            first = np.ceil((pose[:2] - origin_m) / step_m - window / 2).astype(int)
            for row in range(max(first[1], 0), min(first[1] + window, self.rows)):
                for column in range(max(first[0], 0), min(first[0] + window, self.columns)):
                    nodes.append(index * self.places + row * self.columns + column)
        return np.array(nodes, dtype=np.int64)
