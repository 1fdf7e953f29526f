"""The table as squares that one parcel at a time may be on."""

from dataclasses import dataclass
from functools import cached_property
from math import ceil

import numpy as np

from mdms_host.layout import Layout
from mdms_host.routes.space.sweep import Body, Sweeps, sweeps
from mdms_model.arrays import Floats, Ints

#: Parcels that hang over the edge are on tiles of a rim this wide [m].
RIM_M = 0.05


@dataclass(frozen=True)
class Tiles:
    """Squares of a cell's pitch over `per_pitch`, and a rim of such squares around the table.

    They are numbered along x first, the rim's included. Raises ValueError for no whole number of
    squares a cell.
    """

    layout: Layout
    per_pitch: int = 2

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
        return ceil(RIM_M / self.side_m)

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
