"""The new velocity of a parcel on wheels whose pushes are lines clipped by friction.

Wheel i pushes along its direction d_i with f_i = clip(c_i - k_i u_i, -limit_i, +limit_i), u_i the
parcel's speed over it along d_i (eqs 7 to 12 of the paper; rolling where the clip is inactive).
Over an implicit step the new twist xi is the minimum of

    1/2 (xi - xi_0)^T D (xi - xi_0) + sum_i phi_i(J_i xi),   phi_i' = -f_i,   J_i = (d_i, lever_i),

D the parcel's mass matrix per step: strictly convex in three unknowns. Its gradient is piecewise
linear, so a Newton step that ends on the piece where it began has hit the minimum exactly.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdms_model.arrays import Floats
from mdms_model.compiled import compiled
from mdms_model.symmetric3 import Symmetric, Vector, solve
from mdms_sim.physics.plane.motion import new_twist_of, twist_of
from mdms_sim.physics.plane.records import UNSOLVED, Scene

#: A Newton step that would move the parcel by less than this is rounding [m/s].
ROUNDING_M_S = 1e-14
#: Least share of the expected decrease that a step must bring (Armijo's rule).
DECREASE = 1e-4
SHORTEST_STEP = 1e-9
NEWTON_STEPS = 100


class Pushes(NamedTuple):
    """How n wheels push one parcel."""

    jacobian: Floats
    """Direction d_x, d_y and lever [m] about the centre of mass, (n, 3)."""
    line: Floats
    """c [N], k [N s/m] and limit [N], (n, 3)."""
    piece: NDArray[np.int8]
    """Where each wheel is, (n,): 0 rolling, +1 or -1 at that end of its friction."""


@compiled
def settle(twist: Vector, inertia_per_s: Vector, pushes: Pushes) -> tuple[float, float, float, int]:
    """The new twist about the centre of mass from the old one, and the Newton steps it took.

    More than NEWTON_STEPS: it stopped there, short of the minimum.

    `inertia_per_s` is the diagonal of D: mass, mass and moment of inertia over the step.
    """
    at = twist
    value, slope, curvature, _ = objective(at, twist, inertia_per_s, pushes)
    for steps in range(1, NEWTON_STEPS + 1):
        move = solve(curvature, (-slope[0], -slope[1], -slope[2]))
        decrease = -(slope[0] * move[0] + slope[1] * move[1] + slope[2] * move[2])
        if decrease <= inertia_per_s[0] * ROUNDING_M_S**2:
            return at[0], at[1], at[2], steps
        share = 1.0
        while True:
            trial = (at[0] + share * move[0], at[1] + share * move[1], at[2] + share * move[2])
            new_value, slope, curvature, same_piece = objective(trial, twist, inertia_per_s, pushes)
            if share == 1.0 and same_piece:
                return trial[0], trial[1], trial[2], steps
            if value - new_value >= DECREASE * share * decrease or share < SHORTEST_STEP:
                break
            share *= 0.5
        at, value = trial, new_value
    return at[0], at[1], at[2], NEWTON_STEPS + 1


@compiled
def objective(
    at: Vector, twist: Vector, inertia_per_s: Vector, pushes: Pushes
) -> tuple[float, Vector, Symmetric, bool]:
    """Value, gradient and generalised Hessian; True when no wheel changed its piece."""
    jacobian, line, piece = pushes
    r0, r1, r2 = at[0] - twist[0], at[1] - twist[1], at[2] - twist[2]
    g0, g1, g2 = inertia_per_s[0] * r0, inertia_per_s[1] * r1, inertia_per_s[2] * r2
    value = 0.5 * (g0 * r0 + g1 * r1 + g2 * r2)
    h00, h11, h22 = inertia_per_s
    h01, h02, h12 = 0.0, 0.0, 0.0
    same_piece = True
    for i in range(piece.size):
        j0, j1, j2 = jacobian[i, 0], jacobian[i, 1], jacobian[i, 2]
        k, limit = line[i, 1], line[i, 2]
        force = line[i, 0] - k * (j0 * at[0] + j1 * at[1] + j2 * at[2])
        here = 0
        if force > limit:
            value += limit * (force - 0.5 * limit) / k
            force, here = limit, 1
        elif force < -limit:
            value -= limit * (force + 0.5 * limit) / k
            force, here = -limit, -1
        else:
            value += 0.5 * force * force / k
            h00 += k * j0 * j0
            h01 += k * j0 * j1
            h02 += k * j0 * j2
            h11 += k * j1 * j1
            h12 += k * j1 * j2
            h22 += k * j2 * j2
        g0 -= j0 * force
        g1 -= j1 * force
        g2 -= j2 * force
        same_piece &= here == piece[i]
        piece[i] = here
    return value, (g0, g1, g2), (h00, h01, h02, h11, h12, h22), same_piece


@compiled
def push(line: Floats, jacobian: Floats, twist: Vector) -> float:
    """What one wheel, by its `line` (3,), does to a parcel of this twist [N along the wheel]."""
    speed = jacobian[0] * twist[0] + jacobian[1] * twist[1] + jacobian[2] * twist[2]
    return float(min(max(line[0] - line[1] * speed, -line[2]), line[2]))


# Parcels of a scene -------------------------------------------------------------------------------


@compiled
def settle_parcel(scene: Scene, p: int, step_s: float) -> None:
    """Solve for a parcel's twist after an implicit step, under what others press it with."""
    old, body, new = twist_of(scene, p), scene.model.parcels[p], scene.scratch.parcels[p]
    free = (
        old[0] + step_s * new.pressed_x_n / body.mass_kg,
        old[1] + step_s * new.pressed_y_n / body.mass_kg,
        old[2] + step_s * new.pressed_nm / body.inertia_kg_m2,
    )
    vx, vy, yaw_rate, steps = settle(free, inertia_per_s(scene, p, step_s), pushes_on(scene, p))
    new.new_vx_m_s, new.new_vy_m_s, new.new_yaw_rate_rad_s = vx, vy, yaw_rate
    if steps > NEWTON_STEPS:
        scene.scratch.tally[UNSOLVED] += 1


@compiled
def yielding(scene: Scene, p: int, push: Vector, step_s: float) -> float:
    """How much a parcel speeds up along a push (its row of the Jacobian), per newton [m/s/N]."""
    new = new_twist_of(scene, p)
    inertia = inertia_per_s(scene, p, step_s)
    _, _, curvature, _ = objective(new, new, inertia, pushes_on(scene, p))
    faster = solve(curvature, push)
    return push[0] * faster[0] + push[1] * faster[1] + push[2] * faster[2]


@compiled
def inertia_per_s(scene: Scene, p: int, step_s: float) -> Vector:
    """Mass, mass and moment of inertia over the step."""
    body = scene.model.parcels[p]
    return body.mass_kg / step_s, body.mass_kg / step_s, body.inertia_kg_m2 / step_s


@compiled
def pushes_on(scene: Scene, p: int) -> Pushes:
    """The lines of one parcel's supports."""
    share = scene.scratch.parcels[p]
    first, end = 2 * share.first, 2 * share.first + share.lines
    jacobian, line = scene.scratch.jacobian[first:end], scene.scratch.line[first:end]
    return Pushes(jacobian, line, scene.state.piece[first:end])
