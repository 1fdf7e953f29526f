"""The outline that contains every convex parcel over some sensors and beside others.

A convex parcel over the sensors C reaches a point q only if the hull of C and q holds no sensor
that is free. So each free sensor f keeps the parcel out of a shadow: the cone with its apex at f
that the hull of C throws if light comes from there. The rest is the union of all convex parcels
that the sensors allow.
"""

import numpy as np

from mdms_model.arrays import Floats
from mdms_model.outline import convex_hull, polygon_outline

_ANGLES = np.arange(256) * (2 * np.pi / 256)
_DIRECTIONS = np.column_stack((np.cos(_ANGLES), np.sin(_ANGLES)))
#: For the gap between two directions, and for inexact places of sensors [m].
_SPARE_M = 0.005
#: A free sensor so far inside the hull of the covered ones shows that no convex parcel lies there.
_INSIDE_M = 0.002


def containing_outline_m(covered_m: Floats, free_m: Floats, most_m: float) -> Floats:
    """Corners of a convex outline of whatever covers the sensors (C, 2) but not (F, 2), (K, 2).

    It reaches no farther than `most_m` beyond the covered ones, where nothing shows how far.
    """
    hull_m = convex_hull(covered_m)
    centre_m = hull_m.mean(axis=0)
    reach_m = (_DIRECTIONS @ (hull_m - centre_m).T).max(axis=1) + most_m
    if len(hull_m) > 1 and len(free_m):
        reach_m = np.minimum(reach_m, _shadows_m(hull_m, free_m, centre_m))
    rim_m = centre_m + _DIRECTIONS * (reach_m + _SPARE_M)[:, None]
    return convex_hull(np.vstack((rim_m, hull_m)))


def is_convex(covered_m: Floats, free_m: Floats) -> bool:
    """Whether one convex parcel can cover the sensors (C, 2), but not (F, 2)."""
    hull_m = convex_hull(covered_m)
    if len(hull_m) < 3 or not len(free_m):
        return True
    edges = polygon_outline(hull_m).edges
    over_m = free_m @ edges[:, :2].T - edges[:, 2]
    return not (over_m.max(axis=1) < -_INSIDE_M).any()


def _shadows_m(hull_m: Floats, free_m: Floats, centre_m: Floats) -> Floats:
    """How far from the centre the nearest shadow is in each direction [m]; inf without one."""
    from_hull_m = free_m[:, None, :] - hull_m
    outward_m = free_m - centre_m
    # How far the shadow opens to either side of the line from the centre: its two tangents.
    turned = np.arctan2(
        _cross(outward_m[:, None, :], from_hull_m),
        (outward_m[:, None, :] * from_hull_m).sum(axis=2),
    )
    rows = np.arange(len(free_m))
    right_m = from_hull_m[rows, turned.argmin(axis=1)]
    left_m = from_hull_m[rows, turned.argmax(axis=1)]
    # In it is where cross(right, q - f) >= 0 and cross(q - f, left) >= 0, q = centre + r direction.
    along = _DIRECTIONS[:, None, :]
    opens = _cross(right_m, along), _cross(along, left_m)
    needs = _cross(right_m, outward_m), _cross(outward_m, left_m)
    low_m, high_m = np.zeros(opens[0].shape), np.full(opens[0].shape, np.inf)
    for rate, need in zip(opens, needs, strict=True):
        with np.errstate(divide="ignore", invalid="ignore"):
            met_m = need / rate
        low_m = np.where(rate > 0, np.maximum(low_m, met_m), low_m)
        high_m = np.where(rate < 0, np.minimum(high_m, met_m), high_m)
        high_m = np.where((rate == 0) & (need > 0), -np.inf, high_m)
    nearest_m: Floats = np.where(low_m <= high_m, low_m, np.inf).min(axis=1)
    return nearest_m


def _cross(one: Floats, other: Floats) -> Floats:
    product: Floats = one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0]
    return product
