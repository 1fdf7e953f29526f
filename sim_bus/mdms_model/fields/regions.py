"""Which places of the table a region has; regions that touch share no place."""

import numpy as np
from numpy.typing import NDArray

from mdms_model.arrays import Floats
from mdms_model.scenario.motion import Region

Mask = NDArray[np.bool_]


def inside(region: Region | None, positions_m: Floats) -> Mask:
    """Which of the places (W, 2) [m; table frame] are in a region; all are where there is none."""
    if region is None:
        return np.ones(len(positions_m), dtype=np.bool_)
    if region.shape == "disc":
        arms_m = positions_m - region.centre_m
        return np.asarray(np.hypot(*arms_m.T) <= (region.radius_m or 0.0))
    corners_m = np.array(region.corners_m)
    if region.shape == "rectangle":
        low_m, high_m = corners_m.min(axis=0), corners_m.max(axis=0)
        return np.asarray(((positions_m >= low_m) & (positions_m < high_m)).all(axis=1))
    return _in_polygon(corners_m, positions_m)


def _in_polygon(corners_m: Floats, positions_m: Floats) -> Mask:
    """Places from which a ray along x crosses the sides an odd number of times.

    A side is taken from its lower end to its upper, so that for two polygons that share it a place
    is on the same side of it, and has its lower end but not its upper.
    """
    x_m, y_m = positions_m.T
    odd = np.zeros(len(positions_m), dtype=np.bool_)
    for start, end in zip(corners_m, np.roll(corners_m, -1, axis=0), strict=True):
        low, high = (start, end) if start[1] <= end[1] else (end, start)
        level = (low[1] <= y_m) & (y_m < high[1])
        left = (x_m - low[0]) * (high[1] - low[1]) < (y_m - low[1]) * (high[0] - low[0])
        odd ^= level & left
    return odd
