"""How far a parcel is from tipping: its centre of mass inside the hull of what supports it.

Eq (1) of the paper balances a weight with forces that push only as long as the centre of mass lies
within the convex hull of the supports. The margin is its distance from the nearest side of the hull
of all covered wheels: those from which the parcel lifts off carry again before it tips. On a row of
wheels, which is the paper's 1-D model, only the way along the row counts.
"""

import numpy as np
from numpy.typing import NDArray

from mdms_model.arrays import Floats
from mdms_model.hull import LINE_M, convex_hull
from mdms_model.outline import EDGE_M, Outline

#: A centre of mass that is this close above a row of wheels stands on it, as in the physics.
TIP_M = 1e-6

Bools = NDArray[np.bool_]


def support_margin_m(
    wheel_m: Floats,
    outline: Outline,
    centre_of_mass_m: tuple[float, float],
    pose: tuple[float, float, float],
) -> float:
    """Distance of the centre of mass inside the hull of the covered wheels [m]; negative: it tips.

    `wheel_m` (W, 2) are all wheels of the table, `pose` is (x, y, yaw) of the parcel's origin
    [m, m, rad; table frame]. Without any wheel under it the margin is -inf.
    """
    return float(support_margins_m(wheel_m, outline, centre_of_mass_m, np.array([pose]))[0])


def support_margins_m(
    wheel_m: Floats, outline: Outline, centre_of_mass_m: tuple[float, float], poses: Floats
) -> Floats:
    """`support_margin_m` at many poses (P, 3), shape (P,).

    Along a way neighbouring poses share their supports, whose hull is then made once.
    """
    under = _covered(wheel_m, outline, poses)
    centres_m = _turned(np.array([centre_of_mass_m]), poses)[:, 0] + poses[:, :2]
    line = _line_of(wheel_m)
    margins_m = np.full(len(poses), -np.inf)
    changes = np.flatnonzero((under[1:] != under[:-1]).any(axis=1)) + 1
    for group in np.split(np.arange(len(poses)), changes):
        supports_m = wheel_m[under[group[0]]]
        if not len(supports_m):
            continue
        if line is not None:
            margins_m[group] = _inside_line_m(supports_m, centres_m[group], line)
        else:
            margins_m[group] = _inside_hull_m(supports_m, centres_m[group])
    return margins_m


def _covered(wheel_m: Floats, outline: Outline, poses: Floats) -> Bools:
    """Which wheels lie under the outline at which pose, shape (P, W)."""
    away_m = wheel_m - poses[:, None, :2]
    own_m = _turned_back(away_m, poses[:, 2])
    under: Bools = np.hypot(own_m[..., 0], own_m[..., 1]) <= outline.radius_m + EDGE_M
    for along, across, distance_m, *_ in outline.edges.tolist():
        under &= along * own_m[..., 0] + across * own_m[..., 1] <= distance_m + EDGE_M
    return under


def _turned(own_m: Floats, poses: Floats) -> Floats:
    """Vectors (n, 2) of the parcel's frame in the table frame at each pose, shape (P, n, 2)."""
    cosine, sine = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    x_m, y_m = own_m.T
    return np.stack((cosine * x_m - sine * y_m, sine * x_m + cosine * y_m), axis=-1)


def _turned_back(away_m: Floats, yaw_rad: Floats) -> Floats:
    """Vectors (P, n, 2) of the table frame in the frame of parcels turned by each yaw (P,)."""
    cosine, sine = np.cos(yaw_rad)[:, None], np.sin(yaw_rad)[:, None]
    x_m, y_m = away_m[..., 0], away_m[..., 1]
    return np.stack((cosine * x_m + sine * y_m, cosine * y_m - sine * x_m), axis=-1)


def _line_of(wheel_m: Floats) -> Floats | None:
    """Unit vector along the line on which all wheels stand (the paper's row); None: on none."""
    away_m = wheel_m - wheel_m[0]
    along = away_m[np.hypot(away_m[:, 0], away_m[:, 1]).argmax()]
    along = along / max(np.hypot(*along), LINE_M)
    beside_m = np.abs(away_m[:, 0] * along[1] - away_m[:, 1] * along[0])
    return along if beside_m.max() <= LINE_M else None


def _inside_line_m(supports_m: Floats, centres_m: Floats, along: Floats) -> Floats:
    """Distance of places inside the ends of a row; minus that from the row beside it, (P,)."""
    from_first_m = centres_m - supports_m[0]
    beside_m = np.abs(from_first_m[:, 0] * along[1] - from_first_m[:, 1] * along[0])
    place_m, ends_m = centres_m @ along, supports_m @ along
    inside_m = np.minimum(ends_m.max() - place_m, place_m - ends_m.min())
    margins_m: Floats = np.where(beside_m <= TIP_M, inside_m, -beside_m)
    return margins_m


def _inside_hull_m(supports_m: Floats, centres_m: Floats) -> Floats:
    """Distance of places inside the hull of supports, to the nearest line of its sides, (P,).

    Supports in one line hold nothing beside it: the margin is then minus the distance from them.
    """
    corners_m = convex_hull(supports_m)
    if len(corners_m) < 3:
        return -_beside_m(corners_m[0], corners_m[-1], centres_m)
    sides_m = np.roll(corners_m, -1, axis=0) - corners_m
    inward = np.column_stack((-sides_m[:, 1], sides_m[:, 0])) / np.hypot(*sides_m.T)[:, None]
    inside_m: Floats = centres_m @ inward.T - (corners_m * inward).sum(axis=1)
    least_m: Floats = inside_m.min(axis=1)
    return least_m


def _beside_m(start_m: Floats, end_m: Floats, places_m: Floats) -> Floats:
    """Distance of places from the straight line between two points or at one, shape (P,)."""
    along_m = end_m - start_m
    length_m2 = max(float(along_m @ along_m), LINE_M**2)
    share = np.clip((places_m - start_m) @ along_m / length_m2, 0.0, 1.0)
    away_m = places_m - start_m - share[:, None] * along_m
    distance_m: Floats = np.hypot(away_m[:, 0], away_m[:, 1])
    return distance_m
