"""The move that has an edge pass a sensor which shows what is not known well enough of a place."""

from collections.abc import Iterable, Iterator
from math import sqrt
from typing import NamedTuple

import numpy as np

from mdms_host.estimation.outlines.bottom import Bottom
from mdms_model.arrays import Bools, Floats

#: A place is known well enough within these, as standard deviations [m, rad]: within 3 mm and 1
#: degree with 95 %.
SURE_M, SURE_RAD = 0.0012, 0.009
#: A parcel is shifted where no turn helps, and only if its place is not known within these [m,
#: rad]: within 5 mm and 2 degrees with 95 %.
_SHIFTED_M, _SHIFTED_RAD = 0.002, 0.018
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
#: Where no edge makes a place sure, one will do that leaves no more than this of its variance.
_LEFT = 0.5
_ALONG, _ACROSS, _TURN = np.eye(3)


def move_to_feel(
    bottom: Bottom, sensors_m: Floats, usable: Bools, pose: Floats, covariance: Floats
) -> Floats | None:
    """The move (x, y, yaw) after which an edge has made the place surer [m, m, rad].

    Of `sensors_m` (S, 2) those that are `usable` (S,) count; the covariance (3, 3) is of the pose.
    It is the least turn about the centre: that moves no centre of mass, and is not made where the
    parcel does not stand safely however it is turned. Where no turn helps it is the least shift,
    which may take the parcel to where it tips. None where the place is sure, or nothing helps.
    """
    stands = -bottom.distance_m(pose[None, :2], pose)[0] >= _SAFE_M
    near_m = max(_MOST_RAD * bottom.reach_m, _MOST_M)
    near = usable & (abs(bottom.distance_m(sensors_m, pose)) < near_m)
    edges = [bottom.edge(sensor_m, pose) for sensor_m in sensors_m[near]]
    for one in _unsure(covariance):
        for left in (0.0, _LEFT):
            showing = list(_showing(edges, one, covariance, left))
            if stands and (turn_rad := _least(_TURN, _MOST_RAD, showing)) is not None:
                return _TURN * turn_rad
            for shift in one.shifts:
                if (shift_m := _least(shift, _MOST_M, showing)) is not None:
                    return shift * shift_m
    return None


class _Unsure(NamedTuple):
    """What is not known well enough: along `axis` (3,), sure from `sure` on; `shifts` may help."""

    axis: Floats
    sure: float
    shifts: tuple[Floats, ...]


def _unsure(covariance: Floats) -> Iterator[_Unsure]:
    """The place, then the turn."""
    variances, axes = np.linalg.eigh(covariance[:2, :2])
    axis = np.array([*axes[:, 1], 0.0])
    if variances[1] > SURE_M**2:
        yield _Unsure(axis, SURE_M, (axis,) if variances[1] > _SHIFTED_M**2 else ())
    if covariance[2, 2] > SURE_RAD**2:
        shifts = (_ALONG, _ACROSS) if covariance[2, 2] > _SHIFTED_RAD**2 else ()
        yield _Unsure(_TURN, SURE_RAD, shifts)


def _showing(
    edges: Iterable[tuple[float, Floats]], one: _Unsure, covariance: Floats, left: float
) -> Iterator[tuple[float, Floats, float]]:
    """The edges that make a place sure along an axis, each with how sure it is [m].

    So do those that leave no more of its variance than the share `left`.
    """
    unsure = covariance @ one.axis
    before = float(one.axis @ unsure)
    for off_m, slope in edges:
        variance_m2 = float(slope @ covariance @ slope)
        known = float(slope @ unsure) ** 2 / (variance_m2 + _EDGE_M**2)
        if before - known <= max(one.sure**2, left * before):
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
