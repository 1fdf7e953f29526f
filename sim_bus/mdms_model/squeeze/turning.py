"""The turn function and the squeeze function of a polygon: where a squeeze field turns it to."""

from bisect import bisect_right
from dataclasses import dataclass
from math import pi

import numpy as np

from mdms_model.arrays import Floats
from mdms_model.errors import InputError
from mdms_model.squeeze.bisectors import Bisector, Bisectors

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
