"""Squeeze plans: the shortest sequence of squeeze fields after which a polygon has one angle.

A squeeze field pushes with one pressure straight to a line. The polygon first moves until the line
halves its area, then turns while it goes on doing so. With R and L its halves, S their first
moments, d the unit vector across the line to R and e = d' along it, its potential per pressure is U
= (S_R - S_L) d, and U' = (S_R - S_L) e: the halves' centroids are one behind the other, seen along
d, where it rests (Boehringer, Donald and MacDonald 1999, section 4).

The plan is Goldberg's way back from the end (Algorithmica 1993), with the squeeze function of a
field in place of a gripper's: the widest range of angles that one squeeze makes one; the widest
that one squeeze brings into that; and so on, until a range holds all angles. Since the squeeze
function never turns two angles past each other, no sequence is shorter.
"""

from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise
from math import inf, pi
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from mdms_model.arrays import Floats
from mdms_model.errors import InputError
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


#: Angles nearer than this are the same: a plan that needs them apart would not survive a breath.
SAME_RAD = 1e-6


class SqueezeError(InputError):
    """A part that no squeeze field orients."""


@dataclass(frozen=True, slots=True)
class SqueezeFunction:
    """To which angle each angle of a polygon goes under a squeeze field.

    Angles are those of the direction in which the field pushes, seen from the polygon: the field's
    less the yaw. They repeat after `period_rad`: after half a turn, for so does a squeeze field, or
    less where the polygon is alike. Between `unstable_rad[i]` and the next all go to
    `stable_rad[i]`, so that both (K,) ascend, the unstable one first.
    """

    period_rad: float
    stable_rad: tuple[float, ...]
    unstable_rad: tuple[float, ...]

    def __call__(self, angle_rad: float) -> float:
        """Where the polygon comes to rest, in whole periods near `angle_rad`."""
        periods = np.floor((angle_rad - self.unstable_rad[0]) / self.period_rad)
        base_rad = float(periods) * self.period_rad
        basin = bisect_right(self.unstable_rad, angle_rad - base_rad) - 1
        return self.stable_rad[basin] + base_rad

    def turn(self, angle_rad: float) -> int:
        """Which way the angle goes: 1, -1, or 0 where it rests."""
        return int(np.sign(self(angle_rad) - angle_rad))


def squeeze_function(corners_m: Floats) -> SqueezeFunction:
    """The squeeze function of a convex polygon, corners (n, 2) counter-clockwise.

    Raises `SqueezeError` where it has no equilibrium that is one: a polygon too near to a disc.
    """
    bisectors = Bisectors(corners_m)
    places = bisectors.rests()
    rests = [bisectors.at(place) for place in places]
    half = bisectors.opposite(0.0)
    ahead = [*places[1:], places[0] + half] if places else []
    slopes = [
        bisectors.at((place + after) / 2).slope for place, after in zip(places, ahead, strict=True)
    ]
    # Where the slope keeps its sign on both sides the polygon turns on.
    pairs = list(zip(rests, np.roll(slopes, 1), slopes, strict=True))
    stable = [_angle(rest) for rest, before, after in pairs if before < 0.0 < after]
    unstable = [_angle(rest) for rest, before, after in pairs if after < 0.0 < before]
    if not stable or len(stable) != len(unstable):
        raise SqueezeError("no squeeze field turns this polygon; it is too nearly a disc")
    return _reduced(sorted(stable), sorted(unstable))


def _angle(rest: Bisector) -> float:
    return rest.angle_rad % pi


def _reduced(stable: list[float], unstable: list[float]) -> SqueezeFunction:
    """The function over the shortest period after which it repeats."""
    count = len(stable)
    stable = sorted(angle + pi * (angle < unstable[0]) for angle in stable)
    for share in range(count, 0, -1):
        step, period = count // share, pi / share
        if count % share == 0 and all(_repeats(each, step, period) for each in (stable, unstable)):
            return SqueezeFunction(period, tuple(stable[:step]), tuple(unstable[:step]))
    raise SqueezeError(
        "the equilibria of this polygon are nearer to each other than they are exact"
    )


def _repeats(angles: list[float], step: int, period: float) -> bool:
    ahead = [*angles[step:], *(angle + pi for angle in angles[:step])]
    shifts = np.array(ahead) - np.array(angles) - period
    return bool((np.abs(shifts) < SAME_RAD).all())


def alike_turns(corners_m: Floats) -> int:
    """How often a polygon looks the same in one turn; 1: never."""
    corners = Bisectors(corners_m).corners
    places = corners[:, 0] + 1j * corners[:, 1]
    count = len(places)
    for share in range(count, 1, -1):
        turned = places * np.exp(2j * pi / share)
        if count % share == 0 and np.allclose(turned, np.roll(places, -count // share), atol=1e-6):
            return share
    return 1


#: A plan that is exact to less than this would not survive rounding.
LEAST_MARGIN_RAD = 1e-6
HALVINGS = 40


@dataclass(frozen=True, slots=True)
class Range:
    """Some neighbouring basins of a squeeze function, `count` of them from `first` on.

    Angles from `low_rad` to `high_rad` come to rest between `first_rest_rad` and `last_rest_rad`.
    """

    first: int
    count: int
    low_rad: float
    high_rad: float
    first_rest_rad: float
    last_rest_rad: float

    @property
    def width_rad(self) -> float:
        """Width of the input angles."""
        return self.high_rad - self.low_rad

    @property
    def rest_width_rad(self) -> float:
        """Width of the output angles."""
        return self.last_rest_rad - self.first_rest_rad


@dataclass(frozen=True, slots=True)
class Squeeze:
    """One step: a squeeze onto a line along `heading_rad` [table frame, repeats after half a turn].

    Before it the yaw is in a basin of `range`, by `margin_rad` at least, and afterwards one of
    `yaws_rad`, which repeat after the squeeze function's period.
    """

    heading_rad: float
    range: Range
    margin_rad: float
    yaws_rad: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class SqueezePlan:
    """Squeezes in their order, after which the yaw is `yaw_rad`, or that and whole periods."""

    function: SqueezeFunction
    steps: tuple[Squeeze, ...]

    @property
    def yaw_rad(self) -> float:
        """The yaw at the end, from 0 on."""
        return self.steps[-1].yaws_rad[0]

    @property
    def margin_rad(self) -> float:
        """How far every yaw on the way stays from where the polygon would turn the other way."""
        return min(step.margin_rad for step in self.steps)

    def predict(self, yaw_rad: float, step: int) -> float:
        """The yaw [rad] to which a step (from 0) turns this one, without gaps and friction."""
        across_rad = self.steps[step].heading_rad - pi / 2
        return across_rad - self.function(across_rad - yaw_rad)


def plan_squeezes(function: SqueezeFunction, final_yaw_rad: float | None = None) -> SqueezePlan:
    """The shortest plan; of those the one that keeps the widest margin.

    It ends at `final_yaw_rad`, or begins with a squeeze onto a line along x. Raises `SqueezeError`
    where none keeps a margin at all.
    """
    chain = _chain(function, LEAST_MARGIN_RAD)
    if chain is None:
        raise SqueezeError(
            "no sequence of squeezes orients this polygon beyond rounding; it is too nearly alike "
            "when turned"
        )
    low_rad, high_rad = LEAST_MARGIN_RAD, function.period_rad
    for _ in range(HALVINGS):
        middle_rad = (low_rad + high_rad) / 2
        wider = _chain(function, middle_rad)
        if wider is not None and len(wider) == len(chain):
            chain, low_rad = wider, middle_rad
        else:
            high_rad = middle_rad
    return _aim(function, chain[::-1], final_yaw_rad)


def _chain(function: SqueezeFunction, margin_rad: float) -> list[Range] | None:
    """Ranges from the last step to the first, each of which fits into the one before it."""
    ranges = list(_ranges(function))
    whole = len(function.stable_rad)
    chain: list[Range] = []
    room_rad, widest_rad = 2 * margin_rad, 0.0
    while not chain or chain[-1].count < whole:
        fitting = [each for each in ranges if each.rest_width_rad + 2 * margin_rad <= room_rad]
        # Of ranges that hold all the one that leaves the most room.
        best = max(fitting, key=lambda r: (r.width_rad, -r.rest_width_rad), default=None)
        if best is None or best.width_rad <= widest_rad:
            return None
        chain.append(best)
        room_rad = widest_rad = best.width_rad
    return chain


def _ranges(function: SqueezeFunction) -> list[Range]:
    count, period = len(function.stable_rad), function.period_rad
    stable = [angle + k * period for k in range(2) for angle in function.stable_rad]
    unstable = [angle + k * period for k in range(3) for angle in function.unstable_rad]
    return [
        Range(
            first=first,
            count=size,
            low_rad=unstable[first],
            # All angles are one period, whatever rounding has made of its sums.
            high_rad=unstable[first] + period if size == count else unstable[first + size],
            first_rest_rad=stable[first],
            last_rest_rad=stable[first + size - 1],
        )
        for size in range(1, count + 1)
        for first in range(count)
    ]


def _aim(function: SqueezeFunction, chain: list[Range], final_yaw_rad: float | None) -> SqueezePlan:
    """Headings that bring the output of each range into the middle of the next."""
    across_rad, margins_rad = [0.0], [inf]
    for before, after in pairwise(chain):
        turn_rad = (after.low_rad + after.high_rad) / 2
        turn_rad -= (before.first_rest_rad + before.last_rest_rad) / 2
        across_rad.append(across_rad[-1] + turn_rad)
        margins_rad.append((after.width_rad - before.rest_width_rad) / 2)
    period_rad = function.period_rad
    # The direction of the first push, across a line along x, or what ends where it shall.
    shift_rad = pi / 2
    if final_yaw_rad is not None:
        shift_rad = final_yaw_rad - (across_rad[-1] - chain[-1].first_rest_rad)
    steps = []
    for each, range_, margin_rad in zip(across_rad, chain, margins_rad, strict=True):
        pushed_rad = each + shift_rad
        stable = [
            function.stable_rad[k % len(function.stable_rad)]
            for k in range(range_.first, range_.first + range_.count)
        ]
        yaws = tuple(sorted(_wrapped(pushed_rad - rest, period_rad) for rest in stable))
        heading_rad = _wrapped(pushed_rad + pi / 2, pi)
        steps.append(Squeeze(heading_rad, range_, margin_rad, yaws))
    return SqueezePlan(function, tuple(steps))


def _wrapped(angle_rad: float, period_rad: float) -> float:
    """From 0 up to a period; a value a hair below that is 0."""
    wrapped = angle_rad % period_rad
    return 0.0 if period_rad - wrapped < LEAST_MARGIN_RAD / 1000 else wrapped
