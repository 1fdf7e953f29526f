"""Where two convex outlines are closest, and how far apart: separating axes and clipped edges."""

from typing import NamedTuple

import numpy as np

from mdms_model.arrays import Floats, Records
from mdms_model.compiled import compiled
from mdms_model.parcel import Place


class Solid(NamedTuple):
    """The outline of one parcel at its place; a disc has no edges."""

    place: Place
    edges: Floats
    """Edges as in `Outline`, in the parcel's frame, (E, 5)."""
    radius_m: float


@compiled
def solid_of(body: Records, edges: Floats, place: Place) -> Solid:
    """The outline of a parcel at a place."""
    first = body.first_edge
    return Solid(place, edges[first : first + body.edges], body.radius_m)


@compiled
def closest(a: Solid, b: Solid, points: Floats) -> int:
    """Write where a and b are closest into `points` (2, 5); return how many rows, 1 or 2.

    A row is the normal from a to b, the point [m] and the gap [m], less than 0 in penetration.
    Exact where the outlines are near each other.
    """
    if len(a.edges) == 0 and len(b.edges) == 0:
        return _between_discs(a, b, points)
    if len(b.edges) == 0:
        return _to_disc(a, b, 1.0, points)
    if len(a.edges) == 0:
        return _to_disc(b, a, -1.0, points)
    edge_a, gap_a = _widest_edge(a, b)
    edge_b, gap_b = _widest_edge(b, a)
    if gap_a >= gap_b - 1e-9:  # one choice for equal edges, so that it does not flicker
        return _clipped(a, edge_a, b, 1.0, points)
    return _clipped(b, edge_b, a, -1.0, points)


@compiled
def _between_discs(a: Solid, b: Solid, points: Floats) -> int:
    x, y = b.place.x_m - a.place.x_m, b.place.y_m - a.place.y_m
    distance = max(np.hypot(x, y), 1e-12)
    _write(points[0], (x / distance, y / distance), a.place.x_m, a.place.y_m, a.radius_m)
    points[0, 4] = distance - a.radius_m - b.radius_m
    return 1


@compiled
def _to_disc(polygon: Solid, disc: Solid, sign: float, points: Floats) -> int:
    """Polygon and disc, the normal turned round for a negative sign."""
    x, y = _into(polygon.place, disc.place.x_m, disc.place.y_m)
    near_x, near_y, distance = _nearest_point(polygon.edges, x, y)
    normal = _turn(polygon.place, (x - near_x) / distance, (y - near_y) / distance)
    at_x, at_y = _turn(polygon.place, near_x, near_y)
    at_x, at_y = at_x + polygon.place.x_m, at_y + polygon.place.y_m
    _write(points[0], (sign * normal[0], sign * normal[1]), at_x, at_y, 0.0)
    points[0, 4] = distance - disc.radius_m
    return 1


@compiled
def _nearest_point(edges: Floats, x: float, y: float) -> tuple[float, float, float]:
    """The point of a polygon's border nearest to (x, y), and its distance, below 0 from inside."""
    best_x, best_y, best, inside = 0.0, 0.0, np.inf, True
    for e in range(len(edges)):
        next_edge = edges[(e + 1) % len(edges)]
        from_x, from_y = edges[e, 3], edges[e, 4]
        along_x, along_y = next_edge[3] - from_x, next_edge[4] - from_y
        share = ((x - from_x) * along_x + (y - from_y) * along_y) / (along_x**2 + along_y**2)
        share = min(max(share, 0.0), 1.0)
        near_x, near_y = from_x + share * along_x, from_y + share * along_y
        distance = np.hypot(x - near_x, y - near_y)
        if distance < best:
            best_x, best_y, best = near_x, near_y, distance
        inside &= edges[e, 0] * x + edges[e, 1] * y <= edges[e, 2]
    best = max(best, 1e-12)
    return best_x, best_y, -best if inside else best


@compiled
def _widest_edge(a: Solid, b: Solid) -> tuple[int, float]:
    """The edge of a that b lies farthest beyond, and how far."""
    widest, gap = 0, -np.inf
    for e in range(len(a.edges)):
        normal = _turn(a.place, a.edges[e, 0], a.edges[e, 1])
        beyond = np.inf
        for c in range(len(b.edges)):
            beyond = min(beyond, _beyond(a, e, normal, _corner(b, c)))
        if beyond > gap:
            widest, gap = e, beyond
    return widest, gap


@compiled
def _clipped(a: Solid, e: int, b: Solid, sign: float, points: Floats) -> int:
    """The part of b's edge that faces edge e of a, within its length: one or two points."""
    normal = _turn(a.place, a.edges[e, 0], a.edges[e, 1])
    facing = _facing_edge(b, normal)
    p, q = _corner(b, facing), _corner(b, (facing + 1) % len(b.edges))
    along = (-normal[1], normal[0])
    start, end = _corner(a, e), _corner(a, (e + 1) % len(a.edges))
    low, high = _dot(along, start), _dot(along, end)
    at_p, at_q = _dot(along, p), _dot(along, q)
    for i in range(2):
        here, other, at, at_other = (p, q, at_p, at_q) if i == 0 else (q, p, at_q, at_p)
        wanted = min(max(at, low), high)
        share = (wanted - at) / (at_other - at) if abs(at_other - at) > 1e-12 else 0.0
        share = min(max(share, 0.0), 1.0)
        x = here[0] + share * (other[0] - here[0])
        y = here[1] + share * (other[1] - here[1])
        _write(points[i], (sign * normal[0], sign * normal[1]), x, y, 0.0)
        points[i, 4] = _beyond(a, e, normal, (x, y))
    return 2


@compiled
def _facing_edge(b: Solid, normal: tuple[float, float]) -> int:
    facing, least = 0, np.inf
    for e in range(len(b.edges)):
        alike = _dot(normal, _turn(b.place, b.edges[e, 0], b.edges[e, 1]))
        if alike < least:
            facing, least = e, alike
    return facing


@compiled
def _beyond(a: Solid, e: int, normal: tuple[float, float], point: tuple[float, float]) -> float:
    """How far a point lies beyond edge e of a."""
    x, y = point[0] - a.place.x_m, point[1] - a.place.y_m
    return float(normal[0] * x + normal[1] * y - a.edges[e, 2])


@compiled
def _corner(a: Solid, e: int) -> tuple[float, float]:
    x, y = _turn(a.place, a.edges[e, 3], a.edges[e, 4])
    return a.place.x_m + x, a.place.y_m + y


@compiled
def _turn(place: Place, x: float, y: float) -> tuple[float, float]:
    return place.cosine * x - place.sine * y, place.sine * x + place.cosine * y


@compiled
def _into(place: Place, x_m: float, y_m: float) -> tuple[float, float]:
    x, y = x_m - place.x_m, y_m - place.y_m
    return place.cosine * x + place.sine * y, place.cosine * y - place.sine * x


@compiled
def _dot(a: tuple[float, float], b: tuple[float, float]) -> float:
    return a[0] * b[0] + a[1] * b[1]


@compiled
def _write(
    row: Floats, normal: tuple[float, float], x_m: float, y_m: float, ahead_m: float
) -> None:
    row[0], row[1] = normal
    row[2] = x_m + ahead_m * normal[0]
    row[3] = y_m + ahead_m * normal[1]
