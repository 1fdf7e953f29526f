"""Least and greatest normal forces under a parcel, over all poses it may have on a large array."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mdms_model.array import lay_out
from mdms_model.arrays import Floats
from mdms_model.outline import chord_m
from mdms_model.parcel import held_parcel
from mdms_model.scenario.scenario import Parcel, Scenario, ScenarioError
from mdms_model.statics.pose_search import Extremes, Lattice, extremes_at, weigh
from mdms_model.statics.row_supports import stretches_of

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


def _lattice(scenario: Scenario, parcel: Parcel) -> Lattice:
    """Cells far around one at the origin; places within one pitch stand for all."""
    array, reach = scenario.array, _reach(scenario, parcel)
    steps = np.arange(-reach, reach + 1) * array.pitch_m
    rows = steps if array.rows > 1 else np.zeros(1)
    centres_m = np.array([(x_m, y_m) for y_m in rows for x_m in steps])
    wheels = lay_out(centres_m, [scenario.cell] * len(centres_m))
    half_m = np.full(2, array.pitch_m / 2)
    if array.rows == 1:
        half_m[1] = reach * array.pitch_m
    return Lattice(wheels.position_m, -half_m, half_m)


def _reach(scenario: Scenario, parcel: Parcel) -> int:
    """Cells to each side that may lie under the parcel, and some to spare."""
    return math.ceil(math.hypot(parcel.length_m, parcel.width_m) / 2 / scenario.array.pitch_m) + 2
