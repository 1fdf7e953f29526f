"""One step of all parcels on all wheels, as a list of phases; second order away from events.

Footprint, levers and normal forces are taken halfway through the step; the twist comes from the
strictly convex problem of `contact`; parcels then move by the mean of the old and the new twist.
"""

from mdms_model.arrays import Floats
from mdms_model.compiled import compiled, inlined
from mdms_sim.physics.plane.contact import (
    draw_ideal_lines,
    draw_voltage_lines,
    power_wheels,
    push_wheels,
    set_slips,
    settle_parcel,
    spin_ideal,
    spin_voltage,
)
from mdms_sim.physics.plane.records import (
    DROPPED,
    NOW,
    UNBALANCED,
    UNSOLVED,
    Scene,
    move,
    new_twist_of,
    twist_of,
)
from mdms_sim.physics.plane.resting import rest_parcels
from mdms_sim.physics.plane.touch import find_touches, press_apart

#: The reports of a step; they add up. LIMITED: a limit of the solver was reached, see the tally.
TIPPING, TOUCHING, LIMITED = 1, 2, 4


@inlined
def step_ideal(scene: Scene, reference_m_s: Floats, step_s: float) -> int:
    """Massless wheels under the continuous proportional law (eq 9); returns the events to report.

    The implicit midpoint rule: the work of the pushes is the change of kinetic energy, to rounding.
    """
    tipping = rest_parcels(scene, step_s)
    draw_ideal_lines(scene, reference_m_s)
    touching = settle_parcels(scene, step_s, 0.5)
    for p in range(scene.model.parcels.size):
        old, mean = twist_of(scene, p), new_twist_of(scene, p)
        push_wheels(scene, p, mean)
        after = (2.0 * mean[0] - old[0], 2.0 * mean[1] - old[1], 2.0 * mean[2] - old[2])
        move(scene, p, mean, after, step_s)
    spin_ideal(scene, reference_m_s, step_s)
    set_slips(scene)
    return TIPPING * tipping + TOUCHING * touching + LIMITED * limited(scene)


@inlined
def step_voltage(scene: Scene, voltage_v: Floats, step_s: float) -> int:
    """Wheels with inertia under voltages held over the step; returns the events to report.

    A rolling wheel has the parcel's speed at the end of the step; between, it moves exactly.
    """
    tipping = rest_parcels(scene, step_s)
    power_wheels(scene, voltage_v, step_s)
    draw_voltage_lines(scene, step_s)
    touching = settle_parcels(scene, step_s, 1.0)
    for p in range(scene.model.parcels.size):
        old, after = twist_of(scene, p), new_twist_of(scene, p)
        push_wheels(scene, p, after)
        mean = (0.5 * (old[0] + after[0]), 0.5 * (old[1] + after[1]), 0.5 * (old[2] + after[2]))
        move(scene, p, mean, after, step_s)
    spin_voltage(scene)
    set_slips(scene)
    return TIPPING * tipping + TOUCHING * touching + LIMITED * limited(scene)


@inlined
def settle_parcels(scene: Scene, step_s: float, share: float) -> bool:
    """Solve for the twists after a `share` of the step; True when parcels begin to touch."""
    tally = scene.scratch.tally
    for counter in range(tally.size):
        tally[counter] = 0
    # A call that passes all arrays takes as long as the work for a few wheels.
    if scene.model.parcels.size > 1:
        find_touches(scene, step_s)
    for p in range(scene.model.parcels.size):
        body = scene.scratch.parcels[p]
        body.pressed_x_n, body.pressed_y_n, body.pressed_nm = 0.0, 0.0, 0.0
        settle_parcel(scene, p, share * step_s)
    if tally[NOW] == 0:
        scene.state.pairs[0] = 0
        return False
    return press_apart(scene, step_s, share)


@compiled
def limited(scene: Scene) -> bool:
    """Whether this step has reached a limit of the solver."""
    tally = scene.scratch.tally
    return bool(tally[DROPPED] + tally[UNSOLVED] + tally[UNBALANCED] > 0)


@compiled
def observe_ideal(scene: Scene, reference_m_s: Floats) -> int:
    """Set the speeds of the wheels at this very instant under the ideal law; nothing moves."""
    tipping = rest_parcels(scene, 0.0)
    draw_ideal_lines(scene, reference_m_s)
    for p in range(scene.model.parcels.size):
        body = scene.scratch.parcels[p]
        body.new_vx_m_s, body.new_vy_m_s, body.new_yaw_rate_rad_s = twist_of(scene, p)
        push_wheels(scene, p, twist_of(scene, p))
    spin_ideal(scene, reference_m_s, 0.0)
    set_slips(scene)
    return TIPPING * tipping
