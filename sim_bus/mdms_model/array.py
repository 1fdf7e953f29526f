"""All wheels of the array: their places, and the directions of their pushes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdms_model.arrays import Floats
from mdms_model.scenario.scenario import Array, Cell, Scenario


class Grid(NamedTuple):
    """The regular grid of cells, for finding the cells near a place without a search."""

    columns: int
    rows: int
    pitch_m: float
    reach_m: float
    """Farthest that a point of a cell lies from its centre along x or y."""


@dataclass(frozen=True, slots=True)
class Wheels:
    """Positions (W, 2) [m; table frame], unit directions (W, 2) and cells (W,), 0-based.

    Ordered by cell, then axis; cells along x first. Cell c has the wheels first[c] to
    first[c + 1] - 1.
    """

    position_m: Floats
    direction: Floats
    cell: NDArray[np.int64]
    first: NDArray[np.int64]


def cell_centres(array: Array) -> Floats:
    """Centres of the cells (cells, 2), along x first, about the array's centre [m]."""
    column = np.arange(array.columns) - (array.columns - 1) / 2
    row = np.arange(array.rows) - (array.rows - 1) / 2
    y, x = np.meshgrid(row, column, indexing="ij")
    return np.column_stack([x.ravel(), y.ravel()]) * array.pitch_m


def sensor_places_m(array: Array, cell: Cell) -> Floats:
    """Places of all presence sensors (cells, sensors of a cell, 2) [m; table frame]."""
    offsets_m: Floats = np.array(cell.sensor_offset_m, dtype=np.float64)
    return cell_centres(array)[:, None] + offsets_m


def build_cells(scenario: Scenario) -> list[Cell]:
    """Every cell as the scenario has it: patches differ as they say."""
    cells = [scenario.cell] * (scenario.array.columns * scenario.array.rows)
    for patch in scenario.patch:
        given = {
            name: value
            for name, value in (("wheel", patch.wheel), ("friction", patch.friction))
            if value is not None
        }
        for number in patch.cells:
            cells[number - 1] = replace(cells[number - 1], **given)  # type: ignore[arg-type]
    return cells


def build_wheels(scenario: Scenario) -> Wheels:
    """Lay out the wheels of every cell of a scenario."""
    return lay_out(cell_centres(scenario.array), build_cells(scenario))


def lay_out(centres_m: Floats, cells: Sequence[Cell]) -> Wheels:
    """Lay out the wheels of these cells at these centres (cells, 2)."""
    counts = [len(cell.wheel) for cell in cells]
    cell = np.repeat(np.arange(len(cells)), counts)
    wheels = [wheel for own in cells for wheel in own.wheel]
    offset = np.array([wheel.offset_m for wheel in wheels], dtype=np.float64)
    angle = np.array([wheel.direction_rad for wheel in wheels], dtype=np.float64)
    return Wheels(
        position_m=centres_m[cell] + offset,
        direction=np.column_stack([_exact_cos(angle), _exact_cos(angle - np.pi / 2)]),
        cell=cell,
        first=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
    )


def reach_m(offsets_m: Sequence[tuple[float, float]]) -> float:
    """How far these points of a cell lie from its centre at most, along x or y."""
    return max((max(abs(x), abs(y)) for x, y in offsets_m), default=0.0)


def last_support_m(wheels_m: Floats, side: str) -> float:
    """How far the outermost of the wheels (W, 2) is from the table's middle, to a side [m]."""
    across_m = wheels_m[:, 0 if side in ("east", "west") else 1]
    return float((across_m if side in ("east", "north") else -across_m).max())


def edge_m(array: Array, side: str, from_m: float, to_m: float) -> Floats:
    """Both ends (2, 2) of a stretch of the table's edge, cut off at its corners [m]."""
    half_m = np.array([array.columns, array.rows]) * array.pitch_m / 2
    across = 0 if side in ("east", "west") else 1
    ends_m: Floats = np.empty((2, 2))
    ends_m[:, across] = half_m[across] if side in ("east", "north") else -half_m[across]
    ends_m[:, 1 - across] = np.clip((from_m, to_m), -half_m[1 - across], half_m[1 - across])
    return ends_m


def _exact_cos(angle_rad: Floats) -> Floats:
    """Cosine that is exactly zero at right angles, so that wheels along y do not push along x."""
    cosine = np.cos(angle_rad)
    return np.where(np.abs(cosine) < 1e-15, 0.0, cosine)
