"""Open-loop velocity fields: the reference of every wheel, from its place and direction alone.

The numbers are references r of the paper's law V = G (r - v), not speeds: a free wheel runs at
(a/b) r. A rolling policy keeps them so low that all wheels roll. It is for closed loops, which take
a parcel's motion from its wheels. A sliding policy sets them so high that all slide at rest. It
centres a parcel by the mass-spring dynamics of an inward field (paper, section 4).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from mdms_model.array import Wheels, build_cells, build_wheels
from mdms_model.arrays import Floats
from mdms_model.errors import InputError
from mdms_model.motor import drive_of
from mdms_model.scenario.motion import COMPOSED, Part, Region
from mdms_model.scenario.scenario import Parcel, Scenario
from mdms_model.statics.limits import (
    equilibrium_n,
    parcel_limits,
    rolling_equilibrium_max_m_s,
    rolling_max_m_s,
    sliding_min_m_s,
)

Mask = NDArray[np.bool_]


def inside(region: Region | None, positions_m: Floats) -> Mask:
    """Which of the places (W, 2) [m; table frame] are in a region; all are where there is none."""
    if region is None:
        return np.ones(len(positions_m), dtype=np.bool_)
    if region.shape == "disc":
        arms_m = positions_m - region.centre_m
        return np.asarray(np.hypot(*arms_m.T) <= (region.radius_m or 0.0))
    corners_m = np.array(region.corners_m)
    if region.shape == "rectangle":
        low_m, high_m = corners_m.min(axis=0), corners_m.max(axis=0)
        return np.asarray(((positions_m >= low_m) & (positions_m < high_m)).all(axis=1))
    return _in_polygon(corners_m, positions_m)


def _in_polygon(corners_m: Floats, positions_m: Floats) -> Mask:
    """Places from which a ray along x crosses the sides an odd number of times.

    A side is taken from its lower end to its upper, so that for two polygons that share it a place
    is on the same side of it, and has its lower end but not its upper.
    """
    x_m, y_m = positions_m.T
    odd = np.zeros(len(positions_m), dtype=np.bool_)
    for start, end in zip(corners_m, np.roll(corners_m, -1, axis=0), strict=True):
        low, high = (start, end) if start[1] <= end[1] else (end, start)
        level = (low[1] <= y_m) & (y_m < high[1])
        left = (x_m - low[0]) * (high[1] - low[1]) < (y_m - low[1]) * (high[0] - low[0])
        odd ^= level & left
    return odd


class FieldError(InputError):
    """A field is not known or lacks a key that it needs."""


Field = Callable[[Floats, Floats, Part], Floats]


def _along(vectors: Floats, directions: Floats) -> Floats:
    """Component of each vector along the direction of its wheel."""
    return np.asarray((vectors * directions).sum(axis=1))


def _unit(angle_rad: float) -> Floats:
    return np.array([np.cos(angle_rad), np.sin(angle_rad)])


def _heading_and_across(part: Part) -> tuple[Floats, Floats]:
    heading = _unit(part.heading_rad)
    return heading, np.array([-heading[1], heading[0]])


def _turned_left(arms_m: Floats) -> Floats:
    return np.column_stack((-arms_m[:, 1], arms_m[:, 0]))


def _reach_m(arms_m: Floats) -> float:
    """Distance of the outermost wheel; 1 when all are at the centre."""
    return float(np.hypot(*arms_m.T).max(initial=0.0)) or 1.0


def inward(positions_m: Floats, directions: Floats, part: Part) -> Floats:
    """Push towards the centre along x and along y at one speed [m/s] (paper, section 4.2)."""
    arms_m = positions_m - part.centre_m
    return _along(-part.speed_m_s * np.sign(arms_m), directions)


def uniform(positions_m: Floats, directions: Floats, part: Part) -> Floats:
    """Push along one heading at one speed [m/s]."""
    push = part.speed_m_s * _unit(part.heading_rad)
    return _along(np.broadcast_to(push, positions_m.shape), directions)


def rotate(positions_m: Floats, directions: Floats, part: Part) -> Floats:
    """Turn about the centre, counter-clockwise; the outermost wheel has the full speed [m/s]."""
    arms_m = positions_m - part.centre_m
    yaw_rate_rad_s = part.speed_m_s / _reach_m(arms_m)
    return _along(yaw_rate_rad_s * _turned_left(arms_m), directions)


def twist(positions_m: Floats, directions: Floats, part: Part) -> Floats:
    """Move as one rigid body: a velocity of the centre [m/s] and a yaw rate about it [rad/s]."""
    turning = part.yaw_rate_rad_s * _turned_left(positions_m - part.centre_m)
    return _along(np.asarray(part.velocity_m_s) + turning, directions)


def linear(positions_m: Floats, directions: Floats, part: Part) -> Floats:
    """V = A p + c about the centre: a gradient A [1/s] and a velocity c of the centre [m/s].

    Under viscous sliding its net force on a parcel is that of its value at the parcel's centre of
    mass, whatever carries it (Murphey and Burdick, IJRR 2004).
    """
    arms_m = positions_m - part.centre_m
    return _along(arms_m @ np.array(part.gradient_per_s).T + part.velocity_m_s, directions)


def elliptic(positions_m: Floats, directions: Floats, part: Part) -> Floats:
    """Fall down an elliptic potential, steepest along the heading (Kavraki, ICRA 1997).

    The push grows linearly from the centre; along the heading it would reach the full speed [m/s]
    at the distance of the outermost wheel, across it `ratio` times as much.
    """
    arms_m = positions_m - part.centre_m
    heading, across = _heading_and_across(part)
    slope = np.outer(heading, heading) + part.ratio * np.outer(across, across)
    return _along(-part.speed_m_s / _reach_m(arms_m) * arms_m @ slope, directions)


def squeeze(positions_m: Floats, directions: Floats, part: Part) -> Floats:
    """Push at one speed [m/s] straight to a line through the centre along the heading.

    Boehringer, Donald and MacDonald's squeeze field (ICRA 1994).
    """
    _, across = _heading_and_across(part)
    side = np.sign((positions_m - part.centre_m) @ across)
    return _along(-part.speed_m_s * np.outer(side, across), directions)


def lane(positions_m: Floats, directions: Floats, part: Part) -> Floats:
    """Carry along the heading at one speed [m/s], and gather to a line through the centre.

    The push across grows linearly from the line to `ratio` times the speed at the lane's edges,
    half of `width_m` away, and is as much beyond.
    """
    heading, across = _heading_and_across(part)
    half_m = (part.width_m or np.inf) / 2
    aside = np.clip((positions_m - part.centre_m) @ across / half_m, -1.0, 1.0)
    return _along(part.speed_m_s * (heading - part.ratio * np.outer(aside, across)), directions)


def diverter(positions_m: Floats, directions: Floats, part: Part) -> Floats:
    """Carry along the heading as far as the centre, and along `exit_rad` beyond, at one speed."""
    heading, leaving = _unit(part.heading_rad), _unit(part.exit_rad)
    beyond = (positions_m - part.centre_m) @ heading >= 0.0
    return _along(part.speed_m_s * np.where(beyond[:, None], leaving, heading), directions)


def table(positions_m: Floats, directions: Floats, part: Part) -> Floats:
    """Give every wheel its own number [m/s]; raises FieldError unless there is one per wheel."""
    if len(part.table_m_s) != len(directions):
        raise FieldError(
            f"the table of a field needs one speed for each of the {len(directions)} wheels, "
            f"by cell, then by axis; got {len(part.table_m_s)}"
        )
    return np.array(part.table_m_s, dtype=np.float64)


FIELDS: Mapping[str, Field] = {
    "inward": inward,
    "uniform": uniform,
    "rotate": rotate,
    "twist": twist,
    "elliptic": elliptic,
    "squeeze": squeeze,
    "linear": linear,
    "lane": lane,
    "diverter": diverter,
    "table": table,
}


def references_m_s(part: Part, wheels: Wheels, key: str = "motion") -> Floats:
    """References (W,) [m/s] of all wheels, 0 outside the field's region.

    Raises FieldError, with the full path of the key, for a name that no field has, a table of the
    wrong length, and a region without a wheel.
    """
    held = inside(part.region, wheels.position_m)
    if not held.any():
        raise FieldError(
            f"{key}.region has none of the {len(held)} wheels in it; "
            f"{_extent(wheels)}, so move it there"
        )
    return np.where(held, _everywhere_m_s(part, wheels, key), 0.0)


def _everywhere_m_s(part: Part, wheels: Wheels, key: str) -> Floats:
    if part.field in COMPOSED:
        inner = [
            references_m_s(each, wheels, f"{key}.part.{number}")
            for number, each in enumerate(part.part)
        ]
        if part.field == "sum":
            return np.asarray(np.sum(inner, axis=0))
        held = [inside(each.region, wheels.position_m) for each in part.part]
        return np.select(held, inner, 0.0)
    if part.field not in FIELDS:
        names = ", ".join((*FIELDS, *COMPOSED))
        raise FieldError(f"{key}.field: no field is called {part.field!r}; there are {names}")
    try:
        return FIELDS[part.field](wheels.position_m, wheels.direction, part)
    except FieldError as error:
        raise FieldError(f"{key}.field: {error}") from None


def _extent(wheels: Wheels) -> str:
    (left, low), (right, high) = wheels.position_m.min(axis=0), wheels.position_m.max(axis=0)
    return f"wheels stand from x {left:g} to {right:g} m and y {low:g} to {high:g} m"


#: A clamp sets a wheel so much above the limit of eq (15): on the wire are micrometres/s.
CLEAR = 1e-3


class PolicyError(InputError):
    """References outside a policy's limit, or a parcel for which it has none."""


@dataclass(frozen=True, slots=True)
class Bound:
    """The references that a policy allows, for the parcel that bounds them most.

    Wheels that carry less than `normal_n` may slip under a policy that all roll.
    """

    policy: str
    parcel: str
    limit_m_s: float
    rolling_equilibrium_max_m_s: float
    normal_n: float

    def __str__(self) -> str:
        limit = f"{self.limit_m_s:.4g} m/s"
        if self.policy == "sliding":
            return f"all wheels slide under parcel {self.parcel!r} at rest from {limit} on (eq 15)"
        return (
            f"all wheels that carry {self.normal_n:.3g} N of parcel {self.parcel!r} roll in all "
            f"motions up to {limit} (eq 14), and at rest up to "
            f"{self.rolling_equilibrium_max_m_s:.4g} m/s (eq 17)"
        )

    def outside(self, reference_m_s: Floats) -> Floats:
        """Which references are outside; a wheel set to 0 pushes nowhere and is in no policy."""
        speed_m_s = abs(reference_m_s)
        if self.policy == "rolling":
            return np.asarray(speed_m_s > self.limit_m_s)
        return np.asarray((speed_m_s < self.limit_m_s) & (speed_m_s > 0.0))

    def clamp(self, reference_m_s: Floats, cell: NDArray[np.int64]) -> Floats:
        """The references (W,) within the bound; `cell` (W,) has the cell of each wheel.

        To roll, the wheels of a cell are slowed alike, so that it pushes the way it did. Where
        wheels slide the push does not depend on their speed, so that each is sped up alone.
        """
        if self.policy == "sliding":
            raised_m_s = np.copysign(self.limit_m_s * (1 + CLEAR), reference_m_s)
            return np.where(self.outside(reference_m_s), raised_m_s, reference_m_s)
        fastest_m_s = np.zeros(int(cell.max()) + 1)
        np.maximum.at(fastest_m_s, cell, abs(reference_m_s))
        slowed = np.minimum(1.0, self.limit_m_s / np.maximum(fastest_m_s, self.limit_m_s))
        return np.asarray(reference_m_s * slowed[cell])


def bound_of(scenario: Scenario) -> Bound | None:
    """The limits of the scenario's policy with its parcels; None without either.

    Raises PolicyError where it allows nothing, and `ScenarioError` for a parcel that tips in every
    pose.
    """
    policy = scenario.motion.policy
    if policy is None or not scenario.parcel:
        return None
    frictions = [cell.friction for cell in build_cells(scenario)]
    friction = min(frictions) if policy == "rolling" else max(frictions)
    rubbed = replace(scenario, cell=replace(scenario.cell, friction=friction))
    bound = _rolling if policy == "rolling" else _sliding
    bounds = [bound(rubbed, parcel) for parcel in scenario.parcel]
    return (min if policy == "rolling" else max)(bounds, key=lambda bound: bound.limit_m_s)


def _rolling(scenario: Scenario, parcel: Parcel) -> Bound:
    """Eqs (14) and (17), for the least normal force or what counts as light above it."""
    limits, share = parcel_limits(scenario, parcel), scenario.motion.light_share
    weight_n = parcel.mass_kg * scenario.run.gravity_m_s2
    normal_n = max(limits.normal_min_n, share * weight_n / limits.supports_max)
    drive, friction = drive_of(scenario.cell), scenario.cell.friction
    limit_m_s = rolling_max_m_s(drive, friction, normal_n)
    if limit_m_s == 0.0:
        raise PolicyError(
            f"motion.policy is 'rolling', but a wheel under parcel {parcel.name!r} carries nothing "
            "in some pose (eq 2), so that eq (14) allows no reference at all; let wheels slip that "
            "carry little, as in motion.light_share=0.3, or leave motion.policy out"
        )
    rest_m_s = rolling_equilibrium_max_m_s(drive, friction, normal_n)
    return Bound("rolling", parcel.name, limit_m_s, rest_m_s, normal_n)


def _sliding(scenario: Scenario, parcel: Parcel) -> Bound:
    """Eq (15), for the greatest normal force under the centred parcel."""
    drive, friction = drive_of(scenario.cell), scenario.cell.friction
    normal_n = equilibrium_n(scenario, parcel)
    if not isfinite(normal_n):
        raise PolicyError(
            f"motion.policy is 'sliding', but parcel {parcel.name!r} tips at the array's centre, "
            "so that eq (15) has no limit; take a larger parcel, or leave motion.policy out"
        )
    limit_m_s = sliding_min_m_s(drive, friction, normal_n)
    rest_m_s = rolling_equilibrium_max_m_s(drive, friction, normal_n)
    return Bound("sliding", parcel.name, limit_m_s, rest_m_s, normal_n)


@dataclass(frozen=True, slots=True)
class ReferenceCommand:
    """References (W,) [m/s] as the field has them, and as they are set by its policy, if any.

    `outside` counts the wheels whose reference from the field breaks the policy.
    """

    asked_m_s: Floats
    set_m_s: Floats
    bound: Bound | None = None
    outside: int = 0

    def __str__(self) -> str:
        """The references outside the policy, and their limit; empty if there are none."""
        if self.bound is None or not self.outside:
            return ""
        outside_m_s = abs(self.asked_m_s[self.bound.outside(self.asked_m_s)])
        rolling = self.bound.policy == "rolling"
        extreme = f"up to {outside_m_s.max():.4g}" if rolling else f"only {outside_m_s.min():.4g}"
        return (
            f"motion.policy is {self.bound.policy!r}, but {self.outside} of {len(self.asked_m_s)} "
            f"wheels have references of {extreme} m/s; {self.bound}"
        )


def command_of(scenario: Scenario) -> ReferenceCommand:
    """The references of a scenario's field, within its policy or not.

    References make surfaces of free wheels run at (a/b) r; where droop is compensated, r = (b/a) v
    makes them run at the field's v. Raises FieldError, PolicyError where the policy allows nothing,
    and `ScenarioError`.
    """
    motion, wheels = scenario.motion, build_wheels(scenario)
    asked_m_s = references_m_s(motion, wheels)
    if motion.compensate_droop:
        asked_m_s = asked_m_s / drive_of(scenario.cell).droop
    bound = bound_of(scenario)
    if bound is None:
        return ReferenceCommand(asked_m_s, asked_m_s)
    outside = int(np.count_nonzero(bound.outside(asked_m_s)))
    return ReferenceCommand(asked_m_s, bound.clamp(asked_m_s, wheels.cell), bound, outside)


def accepted(scenario: Scenario) -> ReferenceCommand:
    """The command of a scenario; raises PolicyError for one outside a policy that refuses."""
    command = command_of(scenario)
    if command.outside and scenario.motion.outside == "refuse":
        lower = "lower" if scenario.motion.policy == "rolling" else "raise"
        raise PolicyError(
            f"{command}; {lower} the field's speeds, or set motion.outside to 'clamp'"
        )
    return command
