"""A parcel's new twist on the lines of its supports, under what other parcels press it with."""

from mdms_model.arrays import Records
from mdms_model.compiled import compiled
from mdms_model.parcel import new_twist_of, twist_of
from mdms_model.symmetric3 import Vector, solve
from mdms_sim.physics.plane.contact import objective, settle
from mdms_sim.physics.plane.scene import Scene, pushes_on


@compiled
def settle_parcel(scene: Scene, body: Records, step_s: float) -> None:
    """Solve for a parcel's twist at the end of an implicit step."""
    old = twist_of(body)
    free = (
        old[0] + step_s * body.pressed_x_n / body.mass_kg,
        old[1] + step_s * body.pressed_y_n / body.mass_kg,
        old[2] + step_s * body.pressed_nm / body.inertia_kg_m2,
    )
    vx, vy, yaw_rate, _ = settle(free, inertia_per_s(body, step_s), pushes_on(scene, body))
    body.new_vx_m_s, body.new_vy_m_s, body.new_yaw_rate_rad_s = vx, vy, yaw_rate


@compiled
def yielding(scene: Scene, body: Records, push: Vector, step_s: float) -> float:
    """How much a parcel speeds up along a push (its row of the Jacobian), per newton [m/s/N]."""
    new = new_twist_of(body)
    _, _, curvature, _ = objective(new, new, inertia_per_s(body, step_s), pushes_on(scene, body))
    faster = solve(curvature, push)
    return push[0] * faster[0] + push[1] * faster[1] + push[2] * faster[2]


@compiled
def inertia_per_s(body: Records, step_s: float) -> Vector:
    """Mass, mass and moment of inertia over the step."""
    return body.mass_kg / step_s, body.mass_kg / step_s, body.inertia_kg_m2 / step_s
