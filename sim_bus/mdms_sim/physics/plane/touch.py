"""Parcels that touch press each other apart: without friction and without bouncing.

Each touch is a complementarity, 0 <= force, 0 <= v_n - v_target, force (v_n - v_target) = 0, on
the speed v_n at which the parcels part at the end of the step. The forces are found by going round
all touches, each solved by a Newton step on the two parcels' contact problems.
"""

import numpy as np
from numpy.typing import NDArray

from mdms_model.arrays import Records
from mdms_model.compiled import compiled
from mdms_model.parcel import place_of
from mdms_model.symmetric3 import Vector
from mdms_sim.physics.plane.collide import closest, solid_of
from mdms_sim.physics.plane.contact import settle_parcel, yielding
from mdms_sim.physics.plane.motion import halfway, new_twist_of, twist_of
from mdms_sim.physics.plane.records import DROPPED, NOW, UNBALANCED, Scene

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
