"""Parcels as rigid flat-bottomed bodies: their state, their outline, and what lies under them."""

import math
from typing import NamedTuple

import numpy as np

from mdms_sim.physics.compiled import compiled
from mdms_sim.physics.wheels import Grid, Records
from mdms_sim.record import Floats
from mdms_sim.scenario import Parcel

#: Points this far outside the outline still count as under it: rounding of rotations [m].
EDGE_M = 1e-12

#: One parcel in the compiled kernels. Position and velocity are those of the centre of mass.
PARCEL = np.dtype(
    [
        ("x_m", "f8"),
        ("y_m", "f8"),
        ("yaw_rad", "f8"),
        ("vx_m_s", "f8"),
        ("vy_m_s", "f8"),
        ("yaw_rate_rad_s", "f8"),
        ("mass_kg", "f8"),
        ("inertia_kg_m2", "f8"),
        ("centre_x_m", "f8"),  # centre of mass from the geometric centre, in the parcel's frame
        ("centre_y_m", "f8"),
        ("half_length_m", "f8"),
        ("half_width_m", "f8"),
        ("first_edge", "i8"),
        ("edges", "i8"),
        ("tipped", "i8"),
    ],
    align=True,
)


def parcel_records(parcels: tuple[Parcel, ...]) -> tuple[Records, Floats]:
    """Parcels at rest where they start, and all their edges (E, 3): normal and distance."""
    records = np.zeros(len(parcels), dtype=PARCEL)
    edges: list[Floats] = []
    for record, parcel in zip(records, parcels, strict=True):
        outline = rectangle_edges(parcel.length_m, parcel.width_m)
        record["first_edge"], record["edges"] = sum(map(len, edges)), len(outline)
        edges.append(outline)
        _place(record, parcel)
    return records, np.concatenate(edges) if edges else np.zeros((0, 3))


def rectangle_edges(length_m: float, width_m: float) -> Floats:
    """Half-planes n . p <= distance that bound a rectangle about its centre, (4, 3)."""
    half_length, half_width = length_m / 2, width_m / 2
    return np.array(
        [
            [1.0, 0.0, half_length],
            [0.0, 1.0, half_width],
            [-1.0, 0.0, half_length],
            [0.0, -1.0, half_width],
        ]
    )


def _place(record: Records, parcel: Parcel) -> None:
    record["mass_kg"] = parcel.mass_kg
    record["inertia_kg_m2"] = parcel.mass_kg * (parcel.length_m**2 + parcel.width_m**2) / 12
    record["half_length_m"], record["half_width_m"] = parcel.length_m / 2, parcel.width_m / 2
    record["centre_x_m"], record["centre_y_m"] = parcel.centre_of_mass_m
    record["yaw_rad"] = parcel.yaw_rad
    arm_x, arm_y = turned(*parcel.centre_of_mass_m, parcel.yaw_rad)
    record["x_m"], record["y_m"] = parcel.x_m + arm_x, parcel.y_m + arm_y


@compiled
def turned(x_m: float, y_m: float, yaw_rad: float) -> tuple[float, float]:
    """A vector of the parcel's frame in the table frame."""
    cosine, sine = math.cos(yaw_rad), math.sin(yaw_rad)
    return cosine * x_m - sine * y_m, sine * x_m + cosine * y_m


@compiled
def read_poses(parcels: Records, pose: Floats, twist: Floats) -> None:
    """Pose and twist (P, 3) of the geometric centres from those of the centres of mass."""
    for p in range(parcels.size):
        body = parcels[p]
        arm_x, arm_y = turned(body.centre_x_m, body.centre_y_m, body.yaw_rad)
        pose[p, 0] = body.x_m - arm_x
        pose[p, 1] = body.y_m - arm_y
        pose[p, 2] = body.yaw_rad
        twist[p, 0] = body.vx_m_s + body.yaw_rate_rad_s * arm_y
        twist[p, 1] = body.vy_m_s - body.yaw_rate_rad_s * arm_x
        twist[p, 2] = body.yaw_rate_rad_s


class Place(NamedTuple):
    """Where a parcel's geometric centre is, and how it is turned."""

    x_m: float
    y_m: float
    cosine: float
    sine: float


@compiled
def place_of(body: Records, pose: tuple[float, float, float]) -> Place:
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
