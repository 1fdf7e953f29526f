"""Poses that a shape moves between: places at regular steps, a few yaws."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mdms_host.routes.space.shape import Shape
from mdms_host.routes.space.sweep import swept
from mdms_host.routes.space.tiles import Tiles
from mdms_model.arrays import Floats, Ints

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
