"""Over which squares of cells parcels truly lie."""

import numpy as np
from numpy.typing import NDArray

from mdms_model.arrays import Floats, Records
from mdms_model.compiled import compiled
from mdms_model.parcel import Place, place_of

NOBODY = -1


@compiled
def lies_over(
    body: Records, edges: Floats, place: Place, x_m: float, y_m: float, half_m: float
) -> bool:
    """Whether a parcel overlaps a square about (x, y), by the theorem of separating axes."""
    from_x, from_y = x_m - place.x_m, y_m - place.y_m
    reach_m = body.radius_m + half_m * 1.4143
    if from_x * from_x + from_y * from_y > reach_m * reach_m:
        return False
    if body.edges == 0:
        beside_x, beside_y = max(abs(from_x) - half_m, 0.0), max(abs(from_y) - half_m, 0.0)
        return bool(beside_x**2 + beside_y**2 <= body.radius_m**2)
    left, right, low, high = np.inf, -np.inf, np.inf, -np.inf
    for e in range(body.first_edge, body.first_edge + body.edges):
        normal_x = place.cosine * edges[e, 0] - place.sine * edges[e, 1]
        normal_y = place.sine * edges[e, 0] + place.cosine * edges[e, 1]
        nearest = normal_x * from_x + normal_y * from_y
        nearest -= half_m * (abs(normal_x) + abs(normal_y))
        if nearest > edges[e, 2]:
            return False
        corner_x = place.cosine * edges[e, 3] - place.sine * edges[e, 4]
        corner_y = place.sine * edges[e, 3] + place.cosine * edges[e, 4]
        left, right = min(left, corner_x), max(right, corner_x)
        low, high = min(low, corner_y), max(high, corner_y)
    beside = left > from_x + half_m or right < from_x - half_m
    return not (beside or low > from_y + half_m or high < from_y - half_m)


@compiled
def find_parcels(
    parcels: Records,
    bodies: Records,
    edges: Floats,
    centres_m: Floats,
    half_m: float,
    found: NDArray[np.int64],
) -> None:
    """Set for each place the number of a parcel that overlaps the square about it, or `NOBODY`."""
    found[:] = NOBODY
    for p in range(parcels.size):
        body = bodies[p]
        if body.lifted or body.away:
            continue
        place = place_of(parcels[p], (body.x_m, body.y_m, body.yaw_rad))
        for cell in range(found.size):
            x_m, y_m = centres_m[cell, 0], centres_m[cell, 1]
            if lies_over(parcels[p], edges, place, x_m, y_m, half_m):
                found[cell] = p
