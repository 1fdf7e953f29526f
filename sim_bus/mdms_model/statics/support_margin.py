"""How far a parcel is from tipping: its centre of mass inside the hull of what supports it.

Eq (1) of the paper balances a weight with forces that push only as long as the centre of mass lies
within the convex hull of the supports. The margin is its distance from the nearest side of the hull
of all covered wheels: those from which the parcel lifts off carry again before it tips. On a row of
wheels, which is the paper's 1-D model, only the way along the row counts.
"""

from math import cos, hypot, inf, sin
from typing import NamedTuple

import numpy as np

from mdms_model.arrays import Floats
from mdms_model.compiled import compiled
from mdms_model.outline import EDGE_M, LINE_M, Outline

#: A centre of mass that is this close above a row of wheels stands on it, as in the physics.
TIP_M = 1e-6


class _Body(NamedTuple):
    """An outline's normals and distances (E, 3) and its radius, and a centre of mass (2,) in it."""

    edges: Floats
    radius_m: float
    centre_m: Floats


class Contacts(NamedTuple):
    """A parcel on a table: all wheels (W, 2), the line on which they all stand, and its outline."""

    wheel_m: Floats
    line: Floats
    body: _Body


def contacts(wheel_m: Floats, outline: Outline, centre_of_mass_m: tuple[float, float]) -> Contacts:
    """The data of a parcel and a table for `margins_m`, worked out once for both."""
    edges, centre_m = np.ascontiguousarray(outline.edges[:, :3]), np.array(centre_of_mass_m)
    body = _Body(edges, outline.radius_m, centre_m.astype(np.float64))
    return Contacts(np.ascontiguousarray(wheel_m), _line_of(wheel_m), body)


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
    """`support_margin_m` at many poses (P, 3), shape (P,)."""
    return margins_m(contacts(wheel_m, outline, centre_of_mass_m), np.ascontiguousarray(poses))


def _line_of(wheel_m: Floats) -> Floats:
    """Unit vector along the line on which all wheels stand (the paper's row); on none, zero."""
    away_m = wheel_m - wheel_m[0]
    along = away_m[np.hypot(away_m[:, 0], away_m[:, 1]).argmax()]
    along = along / max(np.hypot(*along), LINE_M)
    beside_m = np.abs(away_m[:, 0] * along[1] - away_m[:, 1] * along[0])
    return along if beside_m.max() <= LINE_M else np.zeros(2)


@compiled
def margins_m(parcel: Contacts, poses: Floats) -> Floats:
    """`support_margins_m` of a parcel, poses (P, 3) contiguous, shape (P,)."""
    _, line, body = parcel
    margins_m = np.full(len(poses), -inf)
    wheel_m = _near(parcel.wheel_m, poses, body.radius_m + EDGE_M)
    supports_m = np.empty_like(wheel_m)
    for number in range(len(poses)):
        count = _supports(wheel_m, body, poses[number], supports_m)
        if count == 0:
            continue
        if line[0] != 0.0 or line[1] != 0.0:
            margins_m[number] = _inside_line_m(supports_m, count, line)
        else:
            margins_m[number] = _inside_hull_m(supports_m, count)
    return margins_m


@compiled
def _near(wheel_m: Floats, poses: Floats, reach_m: float) -> Floats:
    """The wheels that may be within reach of any of these poses, (N, 2)."""
    x_m, y_m = poses[:, 0], poses[:, 1]
    low_x_m, high_x_m = x_m.min() - reach_m, x_m.max() + reach_m
    low_y_m, high_y_m = y_m.min() - reach_m, y_m.max() + reach_m
    near_m, count = np.empty_like(wheel_m), 0
    for wheel in range(len(wheel_m)):
        within_x = low_x_m <= wheel_m[wheel, 0] <= high_x_m
        if within_x and low_y_m <= wheel_m[wheel, 1] <= high_y_m:
            near_m[count] = wheel_m[wheel]
            count += 1
    return near_m[:count]


@compiled
def _supports(wheel_m: Floats, body: _Body, pose: Floats, supports_m: Floats) -> int:
    """How many wheels lie under an outline.

    These are the first of `supports_m`, from its centre of mass [table frame].
    """
    cosine, sine = cos(pose[2]), sin(pose[2])
    edges, radius_m, centre_m = body
    centre_x_m = cosine * centre_m[0] - sine * centre_m[1]
    centre_y_m = sine * centre_m[0] + cosine * centre_m[1]
    count = 0
    for wheel in range(len(wheel_m)):
        x_m, y_m = wheel_m[wheel, 0] - pose[0], wheel_m[wheel, 1] - pose[1]
        if x_m * x_m + y_m * y_m > (radius_m + EDGE_M) ** 2:
            continue
        under = True
        own_x_m, own_y_m = cosine * x_m + sine * y_m, cosine * y_m - sine * x_m
        for edge in range(len(edges)):
            if not under:
                break
            along_m = edges[edge, 0] * own_x_m + edges[edge, 1] * own_y_m
            under = along_m <= edges[edge, 2] + EDGE_M
        if under:
            supports_m[count, 0], supports_m[count, 1] = x_m - centre_x_m, y_m - centre_y_m
            count += 1
    return count


@compiled
def _inside_line_m(supports_m: Floats, count: int, along: Floats) -> float:
    """How far 0 is inside the ends of a row of supports; minus that from the row beside it."""
    low_m, high_m = inf, -inf
    for number in range(count):
        place_m = supports_m[number, 0] * along[0] + supports_m[number, 1] * along[1]
        low_m, high_m = min(low_m, place_m), max(high_m, place_m)
    beside_m = abs(supports_m[0, 0] * along[1] - supports_m[0, 1] * along[0])
    return -beside_m if beside_m > TIP_M else min(high_m, -low_m)


@compiled
def _inside_hull_m(supports_m: Floats, count: int) -> float:
    """How far 0 is inside the hull of supports, to the nearest line of its sides.

    Supports in one line hold nothing beside it: the margin is then minus the distance from them.
    The hull is wrapped from one corner to the next (R. Jarvis, 1973).
    """
    first = 0
    for number in range(count):
        lower = supports_m[number, 1] < supports_m[first, 1] or (
            supports_m[number, 1] == supports_m[first, 1]
            and supports_m[number, 0] < supports_m[first, 0]
        )
        first = number if lower else first
    margin_m, corner, second = inf, first, first
    for sides in range(count):
        following = _next_corner(supports_m, count, corner)
        if following == first and sides <= 1:
            return -_beside_m(supports_m[first], supports_m[second])
        x_m, y_m = supports_m[corner]
        along_x_m, along_y_m = supports_m[following, 0] - x_m, supports_m[following, 1] - y_m
        inside_m = (along_y_m * x_m - along_x_m * y_m) / hypot(along_x_m, along_y_m)
        margin_m = min(margin_m, inside_m)
        corner, second = following, following if sides == 0 else second
        if corner == first:
            break
    return margin_m


@compiled
def _next_corner(supports_m: Floats, count: int, corner: int) -> int:
    """The corner of the hull after one, anticlockwise: nothing lies right of the way there.

    Of supports in one line it is the farthest; where all are at one place, the corner itself.
    """
    x_m, y_m = supports_m[corner]
    best, best_x_m, best_y_m = corner, 0.0, 0.0
    for number in range(count):
        away_x_m, away_y_m = supports_m[number, 0] - x_m, supports_m[number, 1] - y_m
        turn_m2 = best_x_m * away_y_m - best_y_m * away_x_m
        in_line = abs(turn_m2) <= LINE_M**2
        farther = hypot(away_x_m, away_y_m) > hypot(best_x_m, best_y_m) + LINE_M
        if (in_line and farther) or (not in_line and turn_m2 < 0.0):
            best, best_x_m, best_y_m = number, away_x_m, away_y_m
    return best


@compiled
def _beside_m(start_m: Floats, end_m: Floats) -> float:
    """Distance of 0 from the straight line between two points or at one."""
    along_x_m, along_y_m = end_m[0] - start_m[0], end_m[1] - start_m[1]
    length_m2 = max(along_x_m**2 + along_y_m**2, LINE_M**2)
    share = -(start_m[0] * along_x_m + start_m[1] * along_y_m) / length_m2
    share = min(max(share, 0.0), 1.0)
    return hypot(start_m[0] + share * along_x_m, start_m[1] + share * along_y_m)
