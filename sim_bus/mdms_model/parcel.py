"""Parcels as rigid flat-bottomed bodies: their mass, their outline, and the wheels under them."""

import math
from typing import NamedTuple

import numpy as np

from mdms_model.array import Grid
from mdms_model.arrays import Floats, Records
from mdms_model.compiled import compiled
from mdms_model.outline import EDGE_M, Outline, outline_of
from mdms_model.scenario.scenario import Parcel, Scenario
from mdms_model.symmetric3 import Vector

#: One parcel, as compiled functions take it.
PARCEL = np.dtype(
    [
        ("mass_kg", "f8"),
        ("inertia_kg_m2", "f8"),
        ("centre_x_m", "f8"),  # centre of mass from the origin, in the parcel's frame
        ("centre_y_m", "f8"),
        ("half_length_m", "f8"),
        ("half_width_m", "f8"),
        ("radius_m", "f8"),
        ("first_edge", "i8"),
        ("edges", "i8"),
    ],
    align=True,
)


def parcel_records(parcels: tuple[Parcel, ...]) -> tuple[Records, Floats]:
    """Parcels, and the edges of all, as in `Outline`.

    Raises `ScenarioError` for an impossible outline.
    """
    # As a recarray its fields have names in plain Python, too.
    records = np.zeros(len(parcels), dtype=PARCEL).view(np.recarray)
    outlines = [outline_of(parcel) for parcel in parcels]
    first = 0
    for record, parcel, outline in zip(records, parcels, outlines, strict=True):
        record["first_edge"], record["edges"] = first, len(outline.edges)
        first += len(outline.edges)
        _fill(record, parcel, outline)
    return records, np.concatenate([np.zeros((0, 5)), *(outline.edges for outline in outlines)])


def _fill(record: Records, parcel: Parcel, outline: Outline) -> None:
    uniform_kg_m2 = parcel.mass_kg * outline.moment_m2
    record["mass_kg"] = parcel.mass_kg
    record["inertia_kg_m2"] = parcel.inertia_kg_m2 or uniform_kg_m2
    record["half_length_m"], record["half_width_m"] = parcel.length_m / 2, parcel.width_m / 2
    record["radius_m"] = outline.radius_m
    record["centre_x_m"], record["centre_y_m"] = parcel.centre_of_mass_m


class HeldParcel(NamedTuple):
    """A parcel as the compiled loops take it: one record and its outline."""

    body: Records
    edges: Floats
    weight_n: float


def held_parcel(scenario: Scenario, parcel: Parcel) -> HeldParcel:
    """A parcel that can be put anywhere."""
    records, edges = parcel_records((parcel,))
    return HeldParcel(records[0], edges, parcel.mass_kg * scenario.run.gravity_m_s2)


@compiled
def turned(x_m: float, y_m: float, yaw_rad: float) -> tuple[float, float]:
    """A vector of the parcel's frame in the table frame."""
    cosine, sine = math.cos(yaw_rad), math.sin(yaw_rad)
    return cosine * x_m - sine * y_m, sine * x_m + cosine * y_m


class Place(NamedTuple):
    """Where a parcel's origin is, and how it is turned."""

    x_m: float
    y_m: float
    cosine: float
    sine: float


@compiled
def place_of(body: Records, pose: Vector) -> Place:
    """Where a parcel is whose centre of mass has this pose."""
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    x = pose[0] - (cosine * body.centre_x_m - sine * body.centre_y_m)
    y = pose[1] - (sine * body.centre_x_m + cosine * body.centre_y_m)
    return Place(x, y, cosine, sine)


@compiled
def covers(body: Records, edges: Floats, place: Place, x_m: float, y_m: float) -> bool:
    """Whether a point of the table lies under a parcel at this place."""
    from_x, from_y = x_m - place.x_m, y_m - place.y_m
    own_x = place.cosine * from_x + place.sine * from_y
    own_y = place.cosine * from_y - place.sine * from_x
    reach = body.radius_m + EDGE_M
    if own_x * own_x + own_y * own_y > reach * reach:
        return False
    for e in range(body.first_edge, body.first_edge + body.edges):
        if edges[e, 0] * own_x + edges[e, 1] * own_y > edges[e, 2] + EDGE_M:
            return False
    return True


@compiled
def cells_near(body: Records, grid: Grid, place: Place) -> tuple[int, int, int, int]:
    """First and past-the-last column, then row, of the cells that may reach under a parcel."""
    cosine, sine = abs(place.cosine), abs(place.sine)
    across = cosine * body.half_length_m + sine * body.half_width_m + grid.reach_m
    along = sine * body.half_length_m + cosine * body.half_width_m + grid.reach_m
    left, right = _cells_between(place.x_m - across, place.x_m + across, grid.pitch_m, grid.columns)
    low, high = _cells_between(place.y_m - along, place.y_m + along, grid.pitch_m, grid.rows)
    return left, right, low, high


@compiled
def _cells_between(low_m: float, high_m: float, pitch_m: float, count: int) -> tuple[int, int]:
    middle = 0.5 * (count - 1)
    slack = EDGE_M / pitch_m
    first = max(math.ceil(low_m / pitch_m + middle - slack), 0)
    last = min(math.floor(high_m / pitch_m + middle + slack), count - 1)
    return int(first), int(last) + 1
