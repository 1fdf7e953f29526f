"""Least and greatest loads of the wheels under a parcel over its places at one yaw, exactly.

For one set of covered wheels all loads are linear in the parcel's place (eq 1), so they are extreme
where the set is about to change in two ways at once: two wheels at the outline. All such places are
tried, a hair to each of their four sides.
"""

import math
from typing import NamedTuple

import numpy as np

from mdms_model.arrays import Floats
from mdms_model.compiled import compiled
from mdms_model.parcel import HeldParcel, covers, place_of, turned
from mdms_model.statics.supports import press

HAIR_M = 1e-9
PARALLEL = 1e-9
X, Y, FIRST_X, FIRST_Y, SECOND_X, SECOND_Y = range(6)
"""A corner: a place of the parcel's centre, and the outline's normals at the two wheels."""


class Lattice(NamedTuple):
    """Wheels (W, 2) far around a cell at the origin, and places that stand for all others [m]."""

    wheel_m: Floats
    low_m: Floats
    high_m: Floats


class Extremes(NamedTuple):
    """Over the places where the parcel stands; `most` is 0 where there are none."""

    least_n: float
    most_n: float
    fewest: int
    most: int


@compiled
def extremes_at(lattice: Lattice, held: HeldParcel, yaw_rad: float) -> Extremes:
    """Loads [N] of covered wheels and numbers of carrying ones, over all places at one yaw."""
    disc = held.body.edges == 0
    corners = disc_corners(lattice, held) if disc else side_corners(lattice, held, yaw_rad)
    found = Extremes(math.inf, 0.0, len(lattice.wheel_m), 0)
    for corner in corners:
        twist = corner[FIRST_X] * corner[SECOND_Y] - corner[FIRST_Y] * corner[SECOND_X]
        for out_1 in (-HAIR_M / twist, HAIR_M / twist):
            for out_2 in (-HAIR_M / twist, HAIR_M / twist):
                x_m = corner[X] + out_1 * corner[SECOND_Y] - out_2 * corner[FIRST_Y]
                y_m = corner[Y] + out_2 * corner[FIRST_X] - out_1 * corner[SECOND_X]
                found = weigh(lattice, held, (x_m, y_m, yaw_rad), found)
    return found


@compiled
def side_corners(lattice: Lattice, held: HeldParcel, yaw_rad: float) -> Floats:
    """Where two wheels are at two sides of a polygon."""
    lines = side_lines(lattice, held, yaw_rad)
    corners, count = np.empty((256, 6)), 0
    for i in range(len(lines)):
        for j in range(i):
            one, other = lines[i], lines[j]
            cross = one[0] * other[1] - one[1] * other[0]
            if abs(cross) < PARALLEL:
                continue
            x_m = (one[2] * other[1] - other[2] * one[1]) / cross
            y_m = (one[0] * other[2] - other[0] * one[2]) / cross
            if (
                inside(lattice, x_m, y_m)
                and near(held, x_m, y_m, one)
                and near(held, x_m, y_m, other)
            ):
                corners = noted(corners, count, (x_m, y_m, one[0], one[1], other[0], other[1]))
                count += 1
    return corners[:count]


@compiled
def side_lines(lattice: Lattice, held: HeldParcel, yaw_rad: float) -> Floats:
    """Places n . p = c of the centre with a wheel at a side: n, c and the wheel's place, (n, 5)."""
    first = held.body.first_edge
    sides = held.edges[first : first + held.body.edges]
    lines = np.empty((len(sides) * len(lattice.wheel_m), 5))
    middle_x = (lattice.low_m[0] + lattice.high_m[0]) / 2
    middle_y = (lattice.low_m[1] + lattice.high_m[1]) / 2
    half_m = math.hypot(lattice.high_m[0] - middle_x, lattice.high_m[1] - middle_y)
    count = 0
    for side in sides:
        normal_x, normal_y = turned(side[0], side[1], yaw_rad)
        for wheel in lattice.wheel_m:
            offset_m = normal_x * wheel[0] + normal_y * wheel[1] - side[2]
            if abs(normal_x * middle_x + normal_y * middle_y - offset_m) <= half_m:
                lines[count] = normal_x, normal_y, offset_m, wheel[0], wheel[1]
                count += 1
    return lines[:count]


@compiled
def near(held: HeldParcel, x_m: float, y_m: float, line: Floats) -> bool:
    """Whether the line's wheel is within the parcel's circle, so that it may be at that side."""
    return bool(math.hypot(line[3] - x_m, line[4] - y_m) <= held.body.radius_m + HAIR_M)


@compiled
def disc_corners(lattice: Lattice, held: HeldParcel) -> Floats:
    """Where two wheels are at the rim of a disc."""
    radius_m = held.body.radius_m
    corners, count = np.empty((256, 6)), 0
    for i in range(len(lattice.wheel_m)):
        for j in range(i):
            one, other = lattice.wheel_m[i], lattice.wheel_m[j]
            half_x, half_y = (other[0] - one[0]) / 2, (other[1] - one[1]) / 2
            apart_m = math.hypot(half_x, half_y)
            if not PARALLEL < apart_m < radius_m * (1 - PARALLEL):
                continue
            rise = math.sqrt(radius_m**2 - apart_m**2) / apart_m
            for side in (-rise, rise):
                x_m, y_m = one[0] + half_x - side * half_y, one[1] + half_y + side * half_x
                if inside(lattice, x_m, y_m):
                    corner = (x_m, y_m, one[0] - x_m, one[1] - y_m, other[0] - x_m, other[1] - y_m)
                    corners = noted(corners, count, corner)
                    count += 1
    return corners[:count]


@compiled
def inside(lattice: Lattice, x_m: float, y_m: float) -> bool:
    """Whether a place is among those that stand for all."""
    across = lattice.low_m[0] - HAIR_M <= x_m <= lattice.high_m[0] + HAIR_M
    along = lattice.low_m[1] - HAIR_M <= y_m <= lattice.high_m[1] + HAIR_M
    return bool(across and along)


@compiled
def noted(
    corners: Floats, count: int, corner: tuple[float, float, float, float, float, float]
) -> Floats:
    """The list with one more corner, in twice the room when it is full."""
    if count == len(corners):
        corners = np.concatenate((corners, np.empty_like(corners)))
    corners[count] = corner
    return corners


@compiled
def weigh(
    lattice: Lattice, held: HeldParcel, pose: tuple[float, float, float], found: Extremes
) -> Extremes:
    """The extremes with one more pose of the parcel's centre; one in which it tips adds nothing."""
    arm_x, arm_y = turned(held.body.centre_x_m, held.body.centre_y_m, pose[2])
    com_x, com_y = pose[0] + arm_x, pose[1] + arm_y
    place = place_of(held.body, (com_x, com_y, pose[2]))
    spot_m, count = np.empty((len(lattice.wheel_m), 2)), 0
    for wheel in lattice.wheel_m:
        if covers(held.body, held.edges, place, wheel[0], wheel[1]):
            spot_m[count, 0], spot_m[count, 1] = wheel[0] - com_x, wheel[1] - com_y
            count += 1
    normal_n = np.empty(count)
    if not press(spot_m[:count], held.weight_n, normal_n):
        return found
    carrying = (normal_n > 0.0).sum()
    return Extremes(
        min(found.least_n, normal_n.min()),
        max(found.most_n, normal_n.max()),
        min(found.fewest, carrying),
        max(found.most, carrying),
    )
