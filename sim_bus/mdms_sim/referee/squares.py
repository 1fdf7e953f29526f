"""Over which squares of cells parcels truly lie."""

from typing import NamedTuple

import numpy as np

from mdms_model.arrays import Floats, Ints, Records
from mdms_model.compiled import compiled
from mdms_model.parcel import Place, place_of

NOBODY = -1


class Shapes(NamedTuple):
    """The parcels, their states and edges, and the middles of the squares (cells, 2)."""

    parcels: Records
    bodies: Records
    edges: Floats
    centres_m: Floats


@compiled
def lies_over(body: Records, edges: Floats, place: Place, middle_m: Floats, half_m: float) -> bool:
    """Whether a parcel overlaps a square about a point, by the theorem of separating axes."""
    from_x, from_y = middle_m[0] - place.x_m, middle_m[1] - place.y_m
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
def find_parcels(shapes: Shapes, half_m: float, found: Ints) -> None:
    """Set for each place the number of a parcel that overlaps the square about it, or `NOBODY`."""
    found[:] = NOBODY
    for p in range(shapes.parcels.size):
        constants, body = shapes.parcels[p], shapes.bodies[p]
        if body.lifted or body.away:
            continue
        place = place_of(constants, (body.x_m, body.y_m, body.yaw_rad))
        for cell in range(found.size):
            if lies_over(constants, shapes.edges, place, shapes.centres_m[cell], half_m):
                found[cell] = p
