"""Least and greatest normal forces under a parcel, over all poses it may have on a large array.

For one set of covered wheels all loads are linear in the parcel's place (eq 1), so they are extreme
where the set is about to change in two ways at once: two wheels at the outline. All such places are
tried, a hair to each of their four sides.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mdms_model.array import lay_out
from mdms_model.arrays import Floats
from mdms_model.compiled import compiled
from mdms_model.outline import chord_m
from mdms_model.parcel import HeldParcel, covers, held_parcel, place_of, turned
from mdms_model.scenario.scenario import Parcel, Scenario, ScenarioError
from mdms_model.statics.supports import press, stretches_of

HAIR_M = 1e-9
PARALLEL = 1e-9
X, Y, FIRST_X, FIRST_Y, SECOND_X, SECOND_Y = range(6)
"""A corner: a place of the parcel's centre, and the outline's normals at the two wheels."""


class WheelLattice(NamedTuple):
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
def extremes_at(lattice: WheelLattice, held: HeldParcel, yaw_rad: float) -> Extremes:
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
def side_corners(lattice: WheelLattice, held: HeldParcel, yaw_rad: float) -> Floats:
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
def side_lines(lattice: WheelLattice, held: HeldParcel, yaw_rad: float) -> Floats:
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
def disc_corners(lattice: WheelLattice, held: HeldParcel) -> Floats:
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
def inside(lattice: WheelLattice, x_m: float, y_m: float) -> bool:
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
    lattice: WheelLattice, held: HeldParcel, pose: tuple[float, float, float], found: Extremes
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


YAWS = 180
ZOOMS = 4
ZOOM_POINTS = 9


@dataclass(frozen=True, slots=True)
class NormalBounds:
    """How many wheels carry a parcel, and how much each [N], over all its poses.

    A covered wheel from which the parcel lifts carries nothing, so the least force is 0 then.
    """

    supports_min: int
    supports_max: int
    normal_min_n: float
    normal_max_n: float


def search_normals(scenario: Scenario, parcel: Parcel) -> NormalBounds:
    """The bounds over the poses in which the parcel stands, away from the ends of the array.

    On one line of wheels the parcel's yaw is its own, in the plane any. Raises `ScenarioError`
    where it stands in no pose.
    """
    found = (
        _row_extremes(scenario, parcel) if on_one_line(scenario) else _extremes(scenario, parcel)
    )
    if not found.most:
        raise ScenarioError(
            f"parcel {parcel.name!r} tips wherever it lies; "
            f"its centre of mass needs wheels around it, and cells are "
            f"{scenario.array.pitch_m:g} m apart"
        )
    return NormalBounds(
        int(found.fewest), int(found.most), float(found.least_n), float(found.most_n)
    )


def on_one_line(scenario: Scenario) -> bool:
    """Whether all wheels stand in one row along x."""
    across_m = {wheel.offset_m[1] for wheel in scenario.cell.wheel}
    return scenario.array.rows == 1 and len(across_m) == 1


def centred_normal_n(scenario: Scenario, parcel: Parcel) -> float:
    """Greatest normal force under a parcel that lies at the array's origin; inf: it tips [N]."""
    array = scenario.array
    x_m = array.pitch_m * (1 - array.columns % 2) / 2
    y_m = array.pitch_m * (1 - array.rows % 2) / 2 if array.rows > 1 else parcel.y_m
    found = _at(scenario, parcel, x_m, y_m)
    return float(found.most_n) if found.most else math.inf


def _row_extremes(scenario: Scenario, parcel: Parcel) -> Extremes:
    """Over one pitch of a long row; loads are extreme where the support set changes (eq 1)."""
    pitch_m, com_m = scenario.array.pitch_m, parcel.centre_of_mass_m[0]
    steps = np.arange(-_reach(scenario, parcel), _reach(scenario, parcel) + 1) * pitch_m
    offsets_m = [wheel.offset_m[0] for wheel in scenario.cell.wheel]
    wheel_x_m = np.sort((steps[:, np.newaxis] + offsets_m).ravel())
    ends_m = chord_m(parcel, scenario.cell.wheel[0].offset_m[1] - parcel.y_m)
    stretches = stretches_of(wheel_x_m, ends_m, com_m)
    loads: list[Floats] = []
    counts: list[int] = []
    for k in np.flatnonzero(stretches.first <= stretches.last):
        low_m, high_m = stretches.edge_m[k], stretches.edge_m[k + 1]
        if high_m > 0.0 and low_m < pitch_m:
            places_m = wheel_x_m[stretches.first[k] : stretches.last[k] + 1]
            loads += [_eq_1(places_m, end_m + com_m) for end_m in (low_m, high_m)]
            counts.append(len(places_m))
    if not counts:
        return Extremes(math.inf, 0.0, 0, 0)
    weight_n = parcel.mass_kg * scenario.run.gravity_m_s2
    least = max(min(float(load.min()) for load in loads), 0.0)
    most = max(float(load.max()) for load in loads)
    return Extremes(least * weight_n, most * weight_n, min(counts), max(counts))


def _eq_1(places_m: Floats, com_x_m: float) -> Floats:
    """Shares of the weight on supports that all carry."""
    arm_m = places_m - places_m.mean()
    shares: Floats = 1 / len(places_m) + (com_x_m - places_m.mean()) * arm_m / (arm_m @ arm_m)
    return shares


def _extremes(scenario: Scenario, parcel: Parcel) -> Extremes:
    """Over all places at many yaws, then closer and closer about the best of them."""
    lattice, held = _lattice(scenario, parcel), held_parcel(scenario, parcel)

    def at(yaw_rad: float) -> Extremes:
        return extremes_at(lattice, held, yaw_rad)

    yaws = np.linspace(-math.pi, math.pi, YAWS, endpoint=False)
    found = [at(yaw) for yaw in yaws]
    step = 2 * math.pi / YAWS
    found += _closer(at, yaws[np.argmin([each.least_n for each in found])], step, _least)
    found += _closer(at, yaws[np.argmax([each.most_n for each in found[:YAWS]])], step, _most)
    return Extremes(
        min(each.least_n for each in found),
        max(each.most_n for each in found),
        min(each.fewest for each in found),
        max(each.most for each in found),
    )


def _least(each: Extremes) -> float:
    return each.least_n


def _most(each: Extremes) -> float:
    return -each.most_n


def _closer(
    at: Callable[[float], Extremes],
    yaw_rad: float,
    step_rad: float,
    badness: Callable[[Extremes], float],
) -> list[Extremes]:
    """The extremes at ever closer yaws about the best so far."""
    found: list[Extremes] = []
    for _ in range(ZOOMS):
        yaws = yaw_rad + np.linspace(-step_rad, step_rad, ZOOM_POINTS)
        tried = [at(yaw) for yaw in yaws]
        yaw_rad = yaws[np.argmin([badness(each) for each in tried])]
        step_rad *= 2 / (ZOOM_POINTS - 1)
        found += tried
    return found


def _at(scenario: Scenario, parcel: Parcel, x_m: float, y_m: float) -> Extremes:
    """At one place, the cell at the origin."""
    held = held_parcel(scenario, parcel)
    nothing = Extremes(math.inf, 0.0, 1_000_000, 0)
    return weigh(_lattice(scenario, parcel), held, (x_m, y_m, parcel.yaw_rad), nothing)


def _lattice(scenario: Scenario, parcel: Parcel) -> WheelLattice:
    """Cells far around one at the origin; places within one pitch stand for all."""
    array, reach = scenario.array, _reach(scenario, parcel)
    steps = np.arange(-reach, reach + 1) * array.pitch_m
    rows = steps if array.rows > 1 else np.zeros(1)
    centres_m = np.array([(x_m, y_m) for y_m in rows for x_m in steps])
    wheels = lay_out(centres_m, [scenario.cell] * len(centres_m))
    half_m = np.full(2, array.pitch_m / 2)
    if array.rows == 1:
        half_m[1] = reach * array.pitch_m
    return WheelLattice(wheels.position_m, -half_m, half_m)


def _reach(scenario: Scenario, parcel: Parcel) -> int:
    """Cells to each side that may lie under the parcel, and some to spare."""
    return math.ceil(math.hypot(parcel.length_m, parcel.width_m) / 2 / scenario.array.pitch_m) + 2
