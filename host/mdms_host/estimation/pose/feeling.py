"""The move after which an edge passes a sensor, and makes an unsure place surer."""

from collections.abc import Iterable, Iterator
from itertools import islice
from math import sqrt
from typing import NamedTuple

import numpy as np

from mdms_host.estimation.footprint import Footprint, edge_of
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
#: An edge shows a direction if it moves by this part of a change of it, or more.
_SHOWN = 0.01
#: A shift by so much takes edges over sensors, wherever they are [m].
_BLIND_M = 0.032
#: A parcel that reaches so far from its centre all around does not tip at this pitch of 127 mm,
#: however it lies [m]. The worst place is between four cells.
_SAFE_M = 0.14
#: How well an edge that is felt is known [m].
_EDGE_M = 0.0005
#: Where no edge makes a place sure, one will do that leaves no more than this of its variance.
_LEFT = 0.5
_ALONG, _ACROSS, _TURN = np.eye(3)


def moves_to_feel(
    footprint: Footprint, sensors_m: Floats, usable: Bools, pose: Floats, covariance: Floats
) -> tuple[Floats, ...]:
    """Moves (x, y, yaw) after each of which an edge has made the place surer [m, m, rad].

    Of `sensors_m` (S, 2) those that are `usable` (S,) count; the covariance (5, 5) is of pose and
    growth: an edge shows less where the size is not known. The first is the least turn about the
    centre: that moves no centre of mass, and is not made where the parcel does not stand safely
    however it is turned. Where no turn helps it is the least shift, which may take the parcel to
    where it tips. None where the place is sure, or nothing helps.

    Others follow only where a shift is worth it: the way back, or another axis. The last are shifts
    by half a cell: where a place is hardly known, none is sure to help, and most will.
    """
    unsure = list(_unsure(covariance))
    if not unsure:
        return ()
    stands = -footprint.distance_m(pose[None, :2], pose)[0] >= _SAFE_M
    near_m = max(_MOST_RAD * footprint.reach_m, _MOST_M)
    near = sensors_m[usable & (abs(footprint.distance_m(sensors_m, pose)) < near_m)]
    found = _found(footprint, near, pose, covariance, unsure, stands=stands)
    shifted = [one for one in unsure if one.shifts]
    slopes = [edge_of(footprint, sensor_m, pose)[1] for sensor_m in near] if shifted else []
    # No edge shows how a disc is turned.
    felt = (one for one in shifted if any(abs(slope @ one.axis) > _SHOWN for slope in slopes))
    shifts = [shift for one in felt for shift in one.shifts]
    if not shifts:
        return tuple(islice(found, 1))
    return (*found, *(shift * way_m for shift in shifts for way_m in (_BLIND_M, -_BLIND_M)))


def _found(
    footprint: Footprint,
    near: Floats,
    pose: Floats,
    covariance: Floats,
    unsure: Iterable["_Unsure"],
    *,
    stands: bool,
) -> Iterator[Floats]:
    """Moves (3,) after which an edge over a sensor `near` (N, 2) has surely made the place surer.

    It may turn where it `stands` however it is turned.
    """
    for one in unsure:
        moves = [(_TURN, _MOST_RAD)] if stands else []
        moves += [(shift, _MOST_M) for shift in one.shifts]
        passed = [
            (move * most, list(_passed(footprint, pose, covariance, near, move * most)))
            for move, most in moves
        ]
        for left in (0.0, _LEFT):
            for most, ends in passed:
                shares = [e for e, slope in ends if one.is_shown_by(slope, covariance, left)]
                # The least, and the least the other way.
                other = (share for share in shares if share * shares[0] < 0.0)
                yield from (most * share for share in (*shares[:1], *islice(other, 1)))


class _Unsure(NamedTuple):
    """An unsure direction `axis` (5,), sure from the deviation `sure` on; `shifts` may help."""

    axis: Floats
    sure: float
    shifts: tuple[Floats, ...]

    def is_shown_by(self, slope: Floats, covariance: Floats, left: float) -> bool:
        """Whether an edge makes it sure, or leaves no more than the share `left` of its variance.

        `slope` (5,) is the derivative of the edge's distance by pose and growth, at the edge.
        """
        unsure = covariance @ self.axis
        before = float(self.axis @ unsure)
        known = float(slope @ unsure) ** 2 / (float(slope @ covariance @ slope) + _EDGE_M**2)
        return before - known <= max(self.sure**2, left * before)


def _unsure(covariance: Floats) -> Iterator[_Unsure]:
    """The place, then the turn."""
    variances, axes = np.linalg.eigh(covariance[:2, :2])
    x, y = axes[:, 1].tolist()
    if variances[1] > SURE_M**2:
        along = np.array([x, y, 0.0])
        shifts: tuple[Floats, ...] = (along,) if variances[1] > _SHIFTED_M**2 else ()
        yield _Unsure(np.array([x, y, 0.0, 0.0, 0.0]), SURE_M, shifts)
    if covariance[2, 2] > SURE_RAD**2:
        shifts = (_ALONG, _ACROSS) if covariance[2, 2] > _SHIFTED_RAD**2 else ()
        yield _Unsure(np.array([0.0, 0.0, 1.0, 0.0, 0.0]), SURE_RAD, shifts)


def _passed(
    footprint: Footprint, pose: Floats, covariance: Floats, sensors_m: Floats, most: Floats
) -> Iterator[tuple[float, Floats]]:
    """The shares of the longest move (3,) after which an edge has surely passed a sensor.

    The least come first. Each has the slope of the edge there (5,): a turn turns it.
    """
    shares = []
    for number, sensor_m in enumerate(sensors_m):
        off_m, slope = footprint.edge(sensor_m, pose)
        rate = float(slope @ most)
        if abs(off_m) < abs(rate):
            shares.append((-off_m / rate, number))
    for share, number in sorted(shares, key=lambda each: abs(each[0])):
        off_m, slope = edge_of(footprint, sensors_m[number], pose + share * most)
        rate = float(slope[:3] @ most)
        if rate:
            beyond = _BEYOND * sqrt(float(slope @ covariance @ slope)) / abs(rate)
            end = share - off_m / rate
            end += beyond if end > 0 else -beyond
            if abs(end) < 1.0:
                yield end, slope
