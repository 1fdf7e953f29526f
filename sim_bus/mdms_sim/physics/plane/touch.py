"""Parcels that touch press each other apart: without friction and without bouncing.

Each touch is a complementarity, 0 <= force, 0 <= v_n - v_target, force (v_n - v_target) = 0, on
the speed v_n at which the parcels part at the end of the step. The forces are found by going round
all touches, each solved by a Newton step on the two parcels' contact problems.
"""

import numpy as np
from numpy.typing import NDArray

from mdms_model.arrays import Records
from mdms_model.compiled import compiled
from mdms_model.parcel import halfway, new_twist_of, place_of, twist_of
from mdms_model.symmetric3 import Vector
from mdms_sim.physics.plane.collide import closest, solid_of
from mdms_sim.physics.plane.scene import Scene
from mdms_sim.physics.plane.settling import settle_parcel, yielding

TOUCH = np.dtype(
    [
        ("a", "i8"),
        ("b", "i8"),
        ("normal_x", "f8"),  # from a to b
        ("normal_y", "f8"),
        ("x_m", "f8"),
        ("y_m", "f8"),
        ("lever_a_m", "f8"),  # of the normal about the centres of mass
        ("lever_b_m", "f8"),
        ("gap_m", "f8"),
        ("target_m_s", "f8"),
        ("force_n", "f8"),
        ("held", "i8"),  # the two touch, and did in the last step
        ("fresh", "i8"),  # they began to touch in this step
    ],
    align=True,
)

#: Parcels that have touched count as touching until they are this far apart [m].
NEAR_M = 1e-4
#: Parcels that meet within a step sink in by less than half of its way; so much is let be [m].
SINK_M = 1e-4
#: Share of a deeper penetration that is undone per second, and the most [m/s].
RECOVERY_PER_S = 10.0
RECOVERY_M_S = 0.05
ROUNDS = 200
ROUNDING_M_S = 1e-12

NOW, FORMER = 0, 1


@compiled
def find_touches(scene: Scene, step_s: float) -> None:
    """List where parcels may touch within the step, by a sweep along x."""
    remember_pairs(scene)
    scene.tally[NOW] = 0
    if scene.parcels.size < 2:
        return
    sort_by_left_end(scene)
    most_m = 0.0
    for p in range(scene.parcels.size):
        most_m = max(most_m, motion(scene.parcels[p], step_s))
    points = np.empty((2, 5))
    for i in range(scene.order.size):
        body = scene.parcels[scene.order[i]]
        reach = span(body) + 2.0 * most_m
        for j in range(i + 1, scene.order.size):
            other = scene.parcels[scene.order[j]]
            if left_end(other) > body.x_m + reach:
                break
            if abs(other.y_m - body.y_m) <= reach + span(other):
                p, q = scene.order[i], scene.order[j]
                note_touches(scene, min(p, q), max(p, q), step_s, points)


@compiled
def span(body: Records) -> float:
    """How far a parcel reaches from its centre of mass at most [m]."""
    return float(body.radius_m + abs(body.centre_x_m) + abs(body.centre_y_m) + NEAR_M)


@compiled
def left_end(body: Records) -> float:
    """Where a parcel ends along -x at most [m; table frame]."""
    return float(body.x_m - span(body))


@compiled
def motion(body: Records, step_s: float) -> float:
    """How far a point of a parcel may go within a step [m]."""
    going = abs(body.vx_m_s) + abs(body.vy_m_s)
    return float(step_s * (going + abs(body.yaw_rate_rad_s) * span(body)))


@compiled
def sort_by_left_end(scene: Scene) -> None:
    """Insertion sort of an order that hardly changes from step to step."""
    order = scene.order
    for i in range(1, order.size):
        p = order[i]
        left = left_end(scene.parcels[p])
        j = i
        while j > 0:
            if left_end(scene.parcels[order[j - 1]]) <= left:
                break
            order[j] = order[j - 1]
            j -= 1
        order[j] = p


@compiled
def note_touches(scene: Scene, p: int, q: int, step_s: float, points: NDArray[np.float64]) -> None:
    """Append the places where parcels p and q are near enough to meet within the step."""
    a, b = scene.parcels[p], scene.parcels[q]
    pose_a, pose_b = halfway(a, step_s), halfway(b, step_s)
    solid_a = solid_of(a, scene.edges, place_of(a, pose_a))
    solid_b = solid_of(b, scene.edges, place_of(b, pose_b))
    within = NEAR_M + motion(a, step_s) + motion(b, step_s)
    for i in range(closest(solid_a, solid_b, points)):
        if points[i, 4] > within or scene.tally[NOW] == scene.touches.size:
            continue
        touch = scene.touches[scene.tally[NOW]]
        scene.tally[NOW] += 1
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
def remember_pairs(scene: Scene) -> None:
    """Keep which pairs touched in the last step."""
    scene.tally[FORMER] = 0
    for t in range(scene.tally[NOW]):
        if scene.touches[t].held:
            scene.partners[scene.tally[FORMER], 0] = scene.touches[t].a
            scene.partners[scene.tally[FORMER], 1] = scene.touches[t].b
            scene.tally[FORMER] += 1


@compiled
def were_partners(scene: Scene, p: int, q: int) -> bool:
    """Whether two parcels touched in the last step."""
    for i in range(scene.tally[FORMER]):
        if scene.partners[i, 0] == p and scene.partners[i, 1] == q:
            return True
    return False


# Forces ------------------------------------------------------------------------------------------


@compiled
def press_apart(scene: Scene, step_s: float, share: float) -> bool:
    """Find the forces between touching parcels; True when two begin to touch.

    The unknown twists are those after `share` of the step: half of it for the midpoint rule.
    """
    count = scene.tally[NOW]
    for t in range(count):
        aim(scene, scene.touches[t], step_s, share)
    for _ in range(ROUNDS):
        worst = 0.0
        for t in range(count):
            worst = max(worst, press_one(scene, scene.touches[t], share * step_s))
        if worst <= ROUNDING_M_S:
            break
    beginning = False
    for t in range(count):
        touch = scene.touches[t]
        if touch.force_n > 0.0 and not touch.held:
            touch.held, touch.fresh = 1, 1
            beginning = True
    return beginning


@compiled
def aim(scene: Scene, touch: Records, step_s: float, share: float) -> None:
    """Set the least speed of parting: no more approach than the gap allows, a slow way out."""
    if touch.gap_m > 0.0:
        end = -touch.gap_m / (0.5 * step_s)
    else:
        end = min(max(-touch.gap_m - SINK_M, 0.0) * RECOVERY_PER_S, RECOVERY_M_S)
    row_a, row_b = rows_of(touch)
    a, b = scene.parcels[touch.a], scene.parcels[touch.b]
    old = dot(row_b, twist_of(b)) - dot(row_a, twist_of(a))
    touch.target_m_s = old + share * (end - old)


@compiled
def press_one(scene: Scene, touch: Records, step_s: float) -> float:
    """One Newton step on the force of one touch; returns by how much it changed the parting."""
    row_a, row_b = rows_of(touch)
    a, b = scene.parcels[touch.a], scene.parcels[touch.b]
    lack = touch.target_m_s - (dot(row_b, new_twist_of(b)) - dot(row_a, new_twist_of(a)))
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
def press_on(scene: Scene, body: Records, row: Vector, force_n: float, step_s: float) -> None:
    """Add a force along a row of the Jacobian to what presses a parcel, and settle it anew."""
    body.pressed_x_n += force_n * row[0]
    body.pressed_y_n += force_n * row[1]
    body.pressed_nm += force_n * row[2]
    settle_parcel(scene, body, step_s)


@compiled
def rows_of(touch: Records) -> tuple[Vector, Vector]:
    """Rows of the Jacobian of the two parcels along the normal."""
    x, y = touch.normal_x, touch.normal_y
    return (x, y, touch.lever_a_m), (x, y, touch.lever_b_m)


@compiled
def dot(row: Vector, twist: Vector) -> float:
    """Speed along a row of the Jacobian."""
    return row[0] * twist[0] + row[1] * twist[1] + row[2] * twist[2]
