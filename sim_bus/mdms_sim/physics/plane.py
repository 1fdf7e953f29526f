"""One step of all parcels on all wheels, as a list of phases; second order away from events.

Footprint, levers and normal forces are taken halfway through the step; the twist comes from the
strictly convex problem of `contact`; parcels then move by the mean of the old and the new twist.
"""

from mdms_sim.physics.compiled import compiled
from mdms_sim.physics.contact import Pushes, settle
from mdms_sim.physics.pushes import (
    clear_wheels,
    draw_ideal_lines,
    draw_voltage_lines,
    push_wheels,
    spin_ideal,
    spin_voltage,
)
from mdms_sim.physics.scene import Scene, rest
from mdms_sim.physics.symmetric3 import Vector
from mdms_sim.physics.wheels import Records
from mdms_sim.record import Floats


@compiled
def step_ideal(scene: Scene, reference_m_s: Floats, step_s: float) -> bool:
    """Massless wheels under the continuous proportional law (eq 9); True when a parcel tipped.

    The implicit midpoint rule: the work of the pushes is the change of kinetic energy, to rounding.
    """
    clear_wheels(scene.wheels)
    tipped = False
    for p in range(scene.parcels.size):
        body = scene.parcels[p]
        twist = (body.vx_m_s, body.vy_m_s, body.yaw_rate_rad_s)
        count, stands = rest(scene, body, halfway(body, step_s))
        tipped |= tips(body, stands)
        draw_ideal_lines(scene, count, reference_m_s)
        middle = settle_parcel(scene, body, count, twist, 0.5 * step_s)
        push_wheels(scene, count, middle)
        move(body, middle, step_s)
        body.vx_m_s = 2.0 * middle[0] - twist[0]
        body.vy_m_s = 2.0 * middle[1] - twist[1]
        body.yaw_rate_rad_s = 2.0 * middle[2] - twist[2]
    spin_ideal(scene.wheels, reference_m_s, step_s)
    return tipped


@compiled
def step_voltage(scene: Scene, voltage_v: Floats, step_s: float) -> bool:
    """Wheels with inertia under voltages held over the step (eq 8); True when a parcel tipped.

    A rolling wheel has the parcel's speed at the end of the step; between, it moves exactly.
    """
    clear_wheels(scene.wheels)
    tipped = False
    for p in range(scene.parcels.size):
        body = scene.parcels[p]
        twist = (body.vx_m_s, body.vy_m_s, body.yaw_rate_rad_s)
        count, stands = rest(scene, body, halfway(body, step_s))
        tipped |= tips(body, stands)
        draw_voltage_lines(scene, count, twist, voltage_v, step_s)
        after = settle_parcel(scene, body, count, twist, step_s)
        push_wheels(scene, count, after)
        middle = (
            0.5 * (twist[0] + after[0]),
            0.5 * (twist[1] + after[1]),
            0.5 * (twist[2] + after[2]),
        )
        move(body, middle, step_s)
        body.vx_m_s, body.vy_m_s, body.yaw_rate_rad_s = after
    spin_voltage(scene.wheels, voltage_v, step_s)
    return tipped


@compiled
def observe_ideal(scene: Scene, reference_m_s: Floats) -> None:
    """Set what the wheels do at this very instant under the ideal law; nothing moves."""
    clear_wheels(scene.wheels)
    for p in range(scene.parcels.size):
        body = scene.parcels[p]
        twist = (body.vx_m_s, body.vy_m_s, body.yaw_rate_rad_s)
        count, _ = rest(scene, body, halfway(body, 0.0))
        draw_ideal_lines(scene, count, reference_m_s)
        push_wheels(scene, count, twist)
    spin_ideal(scene.wheels, reference_m_s, 0.0)


# Parcels ----------------------------------------------------------------------------------------


@compiled
def halfway(body: Records, step_s: float) -> Vector:
    """Pose of the centre of mass half a step ahead."""
    return (
        body.x_m + 0.5 * step_s * body.vx_m_s,
        body.y_m + 0.5 * step_s * body.vy_m_s,
        body.yaw_rad + 0.5 * step_s * body.yaw_rate_rad_s,
    )


@compiled
def tips(body: Records, stands: bool) -> bool:
    """Note a parcel that its supports no longer balance; True only when it begins to tip."""
    if stands or body.tipped:
        return False
    body.tipped = 1
    return True


@compiled
def settle_parcel(scene: Scene, body: Records, count: int, twist: Vector, step_s: float) -> Vector:
    """The parcel's twist at the end of an implicit step on the lines of its supports."""
    per_s = (body.mass_kg / step_s, body.mass_kg / step_s, body.inertia_kg_m2 / step_s)
    pushes = Pushes(scene.jacobian[:count], scene.line[:count], scene.piece[:count])
    vx, vy, yaw_rate, _ = settle(twist, per_s, pushes)
    return vx, vy, yaw_rate


@compiled
def move(body: Records, twist: Vector, step_s: float) -> None:
    """Carry a parcel along its mean twist."""
    body.x_m += step_s * twist[0]
    body.y_m += step_s * twist[1]
    body.yaw_rad += step_s * twist[2]
