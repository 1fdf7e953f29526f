"""The move that has an edge pass a sensor which shows what is not known well enough of a place."""

from collections.abc import Iterable, Iterator
from math import sqrt

import numpy as np

from mdms_host.estimation.outlines.bottom import Bottom
from mdms_model.arrays import Bools, Floats

#: A place is known well enough within this, as a standard deviation [m].
SURE_M = 0.0012
#: A parcel is shifted where no turn helps, and only if its place is not known within this [m].
_SHIFTED_M = 0.0025
#: An edge is felt for by so much of a turn [rad] or shift [m] at most, and this many standard
#: deviations beyond where it is believed to be.
_MOST_RAD = 0.35
_MOST_M = 0.07
_BEYOND = 2.5
#: A parcel that reaches so far from its centre all around does not tip at this pitch of 127 mm,
#: however it lies [m]. The worst place is between four cells.
_SAFE_M = 0.14
#: How well an edge that is felt is known [m].
_EDGE_M = 0.0005


def move_to_feel(
    bottom: Bottom, sensors_m: Floats, usable: Bools, pose: Floats, covariance: Floats
) -> Floats | None:
    """The move (x, y, yaw) after which an edge has made the place sure enough [m, m, rad].

    Of `sensors_m` (S, 2) those that are `usable` (S,) count; the covariance (3, 3) is of the pose.
    It is the least turn about the centre: that moves no centre of mass, and is not made where the
    parcel does not stand safely however it is turned. Where no turn helps it is the least shift,
    which may take the parcel to where it tips. None where the place is sure, or nothing helps.
    """
    variances, axes = np.linalg.eigh(covariance[:2, :2])
    if variances[1] <= SURE_M**2:
        return None
    axis = axes[:, 1]
    near_m = max(_MOST_RAD * bottom.reach_m, _MOST_M)
    near = usable & (abs(bottom.distance_m(sensors_m, pose)) < near_m)
    edges = [bottom.edge(sensor_m, pose) for sensor_m in sensors_m[near]]
    showing = list(_showing(edges, axis, covariance))
    stands = -bottom.distance_m(pose[None, :2], pose)[0] >= _SAFE_M
    turn, shift = np.array([0.0, 0.0, 1.0]), np.array([*axis, 0.0])
    if stands and (turn_rad := _least(turn, _MOST_RAD, showing)) is not None:
        return turn * turn_rad
    if variances[1] > _SHIFTED_M**2 and (shift_m := _least(shift, _MOST_M, showing)) is not None:
        return shift * shift_m
    return None


def _showing(
    edges: Iterable[tuple[float, Floats]], axis: Floats, covariance: Floats
) -> Iterator[tuple[float, Floats, float]]:
    """The edges that would make a place sure along an axis (2,), each with how sure it is [m]."""
    unsure = covariance[:, :2] @ axis
    for off_m, slope in edges:
        variance_m2 = float(slope @ covariance @ slope)
        known_m2 = float(slope @ unsure) ** 2 / (variance_m2 + _EDGE_M**2)
        if float(axis @ unsure[:2]) - known_m2 <= SURE_M**2:
            yield off_m, slope, sqrt(variance_m2)


def _least(
    move: Floats, most: float, showing: Iterable[tuple[float, Floats, float]]
) -> float | None:
    """The least part of a move, (3,), that surely takes one of the edges past its sensor."""
    best = None
    for off_m, slope, deviation_m in showing:
        rate = float(slope @ move)
        if rate:
            beyond = _BEYOND * deviation_m / abs(rate)
            part = -off_m / rate
            part += beyond if part > 0 else -beyond
            if abs(part) < min(most, abs(best) if best else most):
                best = part
    return best
