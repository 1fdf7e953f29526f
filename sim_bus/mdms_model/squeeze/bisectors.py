"""The lines that halve a convex polygon's area, and how it turns when it is squeezed onto one.

A squeeze field pushes with one pressure straight to a line. The polygon first moves until the line
halves its area, then turns while it goes on doing so. With R and L its halves, S their first
moments, d the unit vector across the line to R and e = d' along it, its potential per pressure is
U = (S_R - S_L) d, and U' = (S_R - S_L) e: the halves' centroids are one behind the other, seen
along d, where it rests (Boehringer, Donald and MacDonald 1999, section 4).
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from mdms_model.arrays import Floats
from mdms_model.outline import area_and_moment

#: Roots this far outside an interval belong to its end.
ROUNDING = 1e-7
#: In w h r^2 of one pair of sides stand powers of r up to the fourth.
DEGREE = 4


class Bisector(NamedTuple):
    """A line that halves the area, with one end on the boundary at `start`.

    Places on the boundary count from 0, a whole for each side. `angle_rad` is the direction of d in
    the polygon's frame, `slope` is U' and `energy` U, of a polygon of area 1.
    """

    start: float
    end: float
    angle_rad: float
    slope: float
    energy: float


class Bisectors:
    """All bisectors of a convex polygon, by where they start on its boundary; corners (n, 2)."""

    def __init__(self, corners_m: Floats) -> None:
        corners_m = np.asarray(corners_m, dtype=np.float64)
        area, moment = area_and_moment(corners_m)
        #: Of area 1 and about the centroid, so that no bound below has a unit.
        self.corners = (corners_m - moment / area) / np.sqrt(area)
        self.sides = len(corners_m)

    def point(self, place: float) -> Floats:
        """A point of the boundary."""
        side = int(np.floor(place))
        start, end = self.corners[side % self.sides], self.corners[(side + 1) % self.sides]
        return np.asarray(start + (place - side) * (end - start))

    def opposite(self, place: float) -> float:
        """Where the bisector from this place of the boundary leaves the polygon again."""
        start, passed = self.point(place), 0.0
        for side in range(int(np.floor(place)) + 1, int(np.floor(place)) + self.sides):
            near, far = self.point(side) - start, self.point(side + 1) - start
            wedge = _cross(near, far) / 2
            if passed + wedge >= 0.5:
                return side + float((0.5 - passed) / wedge)
            passed += wedge
        raise ValueError("the corners are those of no convex polygon, counter-clockwise")

    def at(self, place: float) -> Bisector:
        """The bisector that starts at this place of the boundary."""
        start, end, chord, apart = self._cut(place)
        along = chord / np.hypot(*chord)
        across = np.array([along[1], -along[0]])
        angle = float(np.arctan2(across[1], across[0]))
        return Bisector(start, end, angle, float(apart @ along), float(apart @ across))

    def rests(self) -> list[float]:
        """Where the bisectors start at which the polygon does not turn, over half a turn.

        Between two bisectors through a corner the line cuts the same two sides. With r the distance
        of its start from the other side, `slope` times the chord times r^2 is a quartic in r, so
        that five values make it, and its roots are all there are.
        """
        half = self.opposite(0.0)
        corners = [float(side) for side in range(self.sides)]
        turns = np.concatenate([corners, [self.opposite(k) for k in corners], [half]])
        turns = np.unique(np.concatenate([turns, turns - self.sides]))
        turns = turns[(turns >= 0.0) & (turns <= half)]
        found = [
            root
            for low, high in pairwise(turns.tolist())
            if high - low > ROUNDING
            for root in self._roots(low, high)
        ]
        return _merged(found, half)

    def _roots(self, low: float, high: float) -> list[float]:
        middle, reach = (low + high) / 2, (high - low) / 2
        other = int(np.floor(self.opposite(middle)))
        foot, side = self.point(other), self.point(other + 1) - self.point(other)
        nodes = chebyshev.chebpts1(DEGREE + 1)
        values = []
        for node in nodes:
            _, _, chord, apart = self._cut(middle + reach * node)
            distance = _cross(side, self.point(middle + reach * node) - foot)
            values.append(float(apart @ chord) * distance**2)
        quartic = chebyshev.chebfit(nodes, values, DEGREE)
        size = np.abs(quartic).max()
        if size == 0.0:
            return []
        roots = chebyshev.chebroots(chebyshev.chebtrim(quartic, 1e-12 * size))
        real = roots[np.abs(roots.imag) < ROUNDING].real
        inside = np.clip(real[np.abs(real) <= 1.0 + ROUNDING], -1.0, 1.0)
        return [middle + reach * float(root) for root in inside]

    def _cut(self, place: float) -> tuple[float, float, Floats, Floats]:
        """Start, end, the chord between them, and S_R - S_L."""
        end = self.opposite(place)
        between = range(int(np.floor(place)) + 1, int(np.ceil(end)))
        ring = [self.point(place), *(self.point(corner) for corner in between), self.point(end)]
        _, moment = area_and_moment(np.array(ring))
        # About the centroid the halves' moments are opposite.
        return place, end, ring[-1] - ring[0], 2 * moment


def _merged(places: list[float], half: float) -> list[float]:
    """Each place once, in order; `half` is the start again."""
    apart: list[float] = []
    for place in sorted(each if each < half - ROUNDING else 0.0 for each in places):
        if not apart or place - apart[-1] > ROUNDING:
            apart.append(place)
    return apart


def _cross(one: Floats, other: Floats) -> float:
    return float(one[0] * other[1] - one[1] * other[0])
