"""Parcels that touch press each other apart: without friction and without bouncing.

Separating axes and clipped edges give the closest points of two convex outlines. Each touch is a
complementarity, 0 <= force, 0 <= v_n - v_target, force (v_n - v_target) = 0, on the speed v_n at
which the parcels part at the end of the step. The forces are found by going round all touches, each
solved by a Newton step on the two parcels' contact problems.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdms_model.arrays import Floats, Records
from mdms_model.compiled import compiled
from mdms_model.parcel import Place, place_of
from mdms_model.symmetric3 import Vector
from mdms_sim.physics.plane.contact import settle_parcel, yielding
from mdms_sim.physics.plane.records import (
    DROPPED,
    NOW,
    UNBALANCED,
    Scene,
    halfway,
    new_twist_of,
    twist_of,
)


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


#: Parcels that have touched count as touching until they are this far apart [m].
NEAR_M = 1e-4
#: Parcels that meet within a step sink in by less than half of its way; so much is let be [m].
SINK_M = 1e-4
#: Share of a deeper penetration that is undone per second, and the most [m/s].
RECOVERY_PER_S = 10.0
RECOVERY_M_S = 0.05
ROUNDS = 200
ROUNDING_M_S = 1e-12


@compiled
def find_touches(scene: Scene, step_s: float) -> None:
    """List where parcels on the table may touch within the step, by a sweep along x."""
    if scene.model.parcels.size < 2:
        return
    sort_by_left_end(scene)
    most_m = 0.0
    for p in range(scene.model.parcels.size):
        most_m = max(most_m, motion(scene, p, step_s))
    points = np.empty((2, 5))
    order, bodies = scene.state.order, scene.state.parcels
    for i in range(order.size):
        p = order[i]
        if bodies[p].lifted:
            continue
        reach = span(scene, p) + 2.0 * most_m
        for j in range(i + 1, order.size):
            q = order[j]
            if left_end(scene, q) > bodies[p].x_m + reach:
                break
            near = abs(bodies[q].y_m - bodies[p].y_m) <= reach + span(scene, q)
            if near and not bodies[q].lifted:
                note_touches(scene, min(p, q), max(p, q), step_s, points)


@compiled
def span(scene: Scene, p: int) -> float:
    """How far a parcel reaches from its centre of mass at most [m]."""
    body = scene.model.parcels[p]
    return float(body.radius_m + abs(body.centre_x_m) + abs(body.centre_y_m) + NEAR_M)


@compiled
def left_end(scene: Scene, p: int) -> float:
    """Where a parcel ends along -x at most [m; table frame]."""
    return float(scene.state.parcels[p].x_m - span(scene, p))


@compiled
def motion(scene: Scene, p: int, step_s: float) -> float:
    """How far a point of a parcel may go within a step [m]."""
    body = scene.state.parcels[p]
    going = abs(body.vx_m_s) + abs(body.vy_m_s)
    return float(step_s * (going + abs(body.yaw_rate_rad_s) * span(scene, p)))


@compiled
def sort_by_left_end(scene: Scene) -> None:
    """Insertion sort of an order that hardly changes from step to step."""
    order = scene.state.order
    for i in range(1, order.size):
        p = order[i]
        left = left_end(scene, p)
        j = i
        while j > 0:
            if left_end(scene, order[j - 1]) <= left:
                break
            order[j] = order[j - 1]
            j -= 1
        order[j] = p


@compiled
def note_touches(scene: Scene, p: int, q: int, step_s: float, points: NDArray[np.float64]) -> None:
    """Append the places where parcels p and q are near enough to meet within the step."""
    a, b = scene.model.parcels[p], scene.model.parcels[q]
    pose_a, pose_b = halfway(scene, p, step_s), halfway(scene, q, step_s)
    solid_a = solid_of(a, scene.model.edges, place_of(a, pose_a))
    solid_b = solid_of(b, scene.model.edges, place_of(b, pose_b))
    within = NEAR_M + motion(scene, p, step_s) + motion(scene, q, step_s)
    touches, tally = scene.scratch.touches, scene.scratch.tally
    for i in range(closest(solid_a, solid_b, points)):
        if points[i, 4] > within:
            continue
        if tally[NOW] == touches.size:
            tally[DROPPED] += 1
            continue
        touch = touches[tally[NOW]]
        tally[NOW] += 1
        touch.a, touch.b = p, q
        touch.normal_x, touch.normal_y, touch.x_m, touch.y_m, touch.gap_m = points[i]
        touch.lever_a_m = lever(touch, pose_a)
        touch.lever_b_m = lever(touch, pose_b)
        touch.held = touch.gap_m < NEAR_M and were_partners(scene, p, q)
        touch.force_n, touch.fresh = 0.0, 0


@compiled
def lever(touch: Records, pose: Vector) -> float:
    """Lever of a touch's normal about a centre of mass [m]."""
    x, y = touch.x_m - pose[0], touch.y_m - pose[1]
    return float(x * touch.normal_y - y * touch.normal_x)


@compiled
def keep_pairs(scene: Scene) -> None:
    """Keep which pairs touch, for the next step."""
    state, touches = scene.state, scene.scratch.touches
    state.pairs[0] = 0
    for t in range(scene.scratch.tally[NOW]):
        if touches[t].held:
            state.partners[state.pairs[0], 0] = touches[t].a
            state.partners[state.pairs[0], 1] = touches[t].b
            state.pairs[0] += 1


@compiled
def were_partners(scene: Scene, p: int, q: int) -> bool:
    """Whether two parcels touched in the last step."""
    state = scene.state
    for i in range(state.pairs[0]):
        if state.partners[i, 0] == p and state.partners[i, 1] == q:
            return True
    return False


# Forces ------------------------------------------------------------------------------------------


@compiled
def press_apart(scene: Scene, step_s: float, share: float) -> bool:
    """Find the forces between touching parcels; True when two begin to touch.

    The unknown twists are those after `share` of the step: half of it for the midpoint rule.
    """
    touches, count = scene.scratch.touches, scene.scratch.tally[NOW]
    for t in range(count):
        aim(scene, touches[t], step_s, share)
    if not balance(scene, share * step_s):
        scene.scratch.tally[UNBALANCED] += 1
    beginning = False
    for t in range(count):
        touch = touches[t]
        if touch.force_n > 0.0 and not touch.held:
            touch.held, touch.fresh = 1, 1
            beginning = True
    keep_pairs(scene)
    return beginning


@compiled
def balance(scene: Scene, step_s: float) -> bool:
    """Go round the touches until no force changes; False when the rounds do not suffice."""
    for _ in range(ROUNDS):
        worst = 0.0
        for t in range(scene.scratch.tally[NOW]):
            worst = max(worst, press_one(scene, scene.scratch.touches[t], step_s))
        if worst <= ROUNDING_M_S:
            return True
    return False


@compiled
def aim(scene: Scene, touch: Records, step_s: float, share: float) -> None:
    """Set the least speed of parting: no more approach than the gap allows, a slow way out."""
    if touch.gap_m > 0.0:
        end = -touch.gap_m / (0.5 * step_s)
    else:
        end = min(max(-touch.gap_m - SINK_M, 0.0) * RECOVERY_PER_S, RECOVERY_M_S)
    row_a, row_b = rows_of(touch)
    old = dot(row_b, twist_of(scene, touch.b)) - dot(row_a, twist_of(scene, touch.a))
    touch.target_m_s = old + share * (end - old)


@compiled
def press_one(scene: Scene, touch: Records, step_s: float) -> float:
    """One Newton step on the force of one touch; returns by how much it changed the parting."""
    row_a, row_b = rows_of(touch)
    a, b = touch.a, touch.b
    parting = dot(row_b, new_twist_of(scene, b)) - dot(row_a, new_twist_of(scene, a))
    lack = touch.target_m_s - parting
    if lack <= 0.0 and touch.force_n == 0.0:
        return 0.0
    give = yielding(scene, a, row_a, step_s) + yielding(scene, b, row_b, step_s)
    force_n = max(0.0, touch.force_n + lack / give)
    more_n = force_n - touch.force_n
    touch.force_n = force_n
    press_on(scene, a, row_a, -more_n, step_s)
    press_on(scene, b, row_b, more_n, step_s)
    return float(abs(more_n) * give)


@compiled
def press_on(scene: Scene, p: int, row: Vector, force_n: float, step_s: float) -> None:
    """Add a force along a row of the Jacobian to what presses a parcel, and settle it anew."""
    body = scene.scratch.parcels[p]
    body.pressed_x_n += force_n * row[0]
    body.pressed_y_n += force_n * row[1]
    body.pressed_nm += force_n * row[2]
    settle_parcel(scene, p, step_s)


@compiled
def rows_of(touch: Records) -> tuple[Vector, Vector]:
    """Rows of the Jacobian of the two parcels along the normal."""
    x, y = touch.normal_x, touch.normal_y
    return (x, y, touch.lever_a_m), (x, y, touch.lever_b_m)


@compiled
def dot(row: Vector, twist: Vector) -> float:
    """Speed along a row of the Jacobian."""
    return row[0] * twist[0] + row[1] * twist[1] + row[2] * twist[2]
