"""The turn that has an edge pass a sensor which shows what is not known well enough of a place."""

from math import sqrt

import numpy as np

from mdms_host.estimation.outlines.bottom import Bottom
from mdms_model.arrays import Bools, Floats

#: A place is known well enough within this, as a standard deviation [m].
SURE_M = 0.0012
#: An edge is felt for by a turn of so much at most [rad], and this many standard deviations beyond
#: where it is believed to be.
_MOST_RAD = 0.35
_BEYOND = 2.5
#: A parcel that reaches so far from its centre all around does not tip at this pitch of 127 mm,
#: however it lies [m]. The worst place is between four cells.
_SAFE_M = 0.14
#: How well an edge that is felt is known [m].
_EDGE_M = 0.0005


def turn_to_feel_rad(
    bottom: Bottom, sensors_m: Floats, usable: Bools, pose: Floats, covariance: Floats
) -> float | None:
    """The least turn about the centre after which an edge has made the place sure enough [rad].

    Of `sensors_m` (S, 2) those that are `usable` (S,) count; the covariance (3, 3) is of the pose.
    None where the place is sure, or where no turn makes it so. A turn moves no centre of mass; one
    of a parcel that does not stand safely however it is turned is not made.
    """
    if -bottom.distance_m(pose[None, :2], pose)[0] < _SAFE_M:
        return None
    variances, axes = np.linalg.eigh(covariance[:2, :2])
    if variances[1] <= SURE_M**2:
        return None
    unsure = covariance[:, :2] @ axes[:, 1]
    best_rad = None
    near = usable & (abs(bottom.distance_m(sensors_m, pose)) < _MOST_RAD * bottom.reach_m)
    for sensor in np.flatnonzero(near).tolist():
        off_m, slope = bottom.edge(sensors_m[sensor], pose)
        variance_m2 = float(slope @ covariance @ slope)
        left_m2 = variances[1] - float(slope @ unsure) ** 2 / (variance_m2 + _EDGE_M**2)
        if left_m2 > SURE_M**2 or not slope[2]:
            continue
        beyond_rad = _BEYOND * sqrt(variance_m2) / abs(slope[2])
        turn_rad = -off_m / float(slope[2])
        turn_rad += beyond_rad if turn_rad > 0 else -beyond_rad
        if abs(turn_rad) < min(_MOST_RAD, abs(best_rad) if best_rad else _MOST_RAD):
            best_rad = turn_rad
    return best_rad
