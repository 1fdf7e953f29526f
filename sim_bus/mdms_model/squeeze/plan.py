"""The shortest sequence of squeeze fields after which a polygon has one angle, whatever its first.

Goldberg's way back from the end (Algorithmica 1993), with the squeeze function of a field in place
of a gripper's: the widest range of angles that one squeeze makes one; the widest that one squeeze
brings into that; and so on, until a range holds all angles. Since the squeeze function never turns
two angles past each other, no sequence is shorter.
"""

from dataclasses import dataclass
from itertools import pairwise
from math import inf, pi

from mdms_model.squeeze.turning import SqueezeError, SqueezeFunction

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
