"""The effect of each wheel on its parcel, as a clipped line, and of the parcel on the wheel."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdms_model.arrays import Floats
from mdms_model.compiled import compiled, inlined
from mdms_model.run.record import Contact
from mdms_model.symmetric3 import Symmetric, Vector, solve
from mdms_sim.physics.motor import applied_voltage, coast
from mdms_sim.physics.plane.records import UNSOLVED, Scene, new_twist_of, twist_of

#: A Newton step that would move the parcel by less than this is rounding [m/s].
ROUNDING_M_S = 1e-14
#: Least share of the expected decrease that a step must bring (Armijo's rule).
DECREASE = 1e-4
SHORTEST_STEP = 1e-9
NEWTON_STEPS = 100


class WheelPushes(NamedTuple):
    """How n wheels push one parcel."""

    jacobian: Floats
    """Direction d_x, d_y and lever [m] about the centre of mass, (n, 3)."""
    line: Floats
    """c [N], k [N s/m] and limit [N], (n, 3)."""
    piece: NDArray[np.int8]
    """Where each wheel is, (n,): 0 rolling, +1 or -1 at that end of its friction."""


@inlined
def settle(
    twist: Vector, inertia_per_s: Vector, pushes: WheelPushes
) -> tuple[float, float, float, int]:
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


@inlined
def objective(
    at: Vector, twist: Vector, inertia_per_s: Vector, pushes: WheelPushes
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
    """The push of one wheel, by its `line` (3,), on a parcel of this twist [N along the wheel]."""
    speed = jacobian[0] * twist[0] + jacobian[1] * twist[1] + jacobian[2] * twist[2]
    return float(min(max(line[0] - line[1] * speed, -line[2]), line[2]))


# Parcels of a scene -------------------------------------------------------------------------------


@inlined
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
def pushes_on(scene: Scene, p: int) -> WheelPushes:
    """The lines of one parcel's supports."""
    share = scene.scratch.parcels[p]
    first, end = 2 * share.first, 2 * share.first + share.lines
    jacobian, line = scene.scratch.jacobian[first:end], scene.scratch.line[first:end]
    return WheelPushes(jacobian, line, scene.state.piece[first:end])


NONE, ROLLING = int(Contact.NONE), int(Contact.ROLLING)
FORWARD, BACKWARD = int(Contact.SLIDING_FORWARD), int(Contact.SLIDING_BACKWARD)

#: A roller with friction creeps: its push grows in proportion up to this speed [m/s].
CREEP_M_S = 1e-3

#: A jammed wheel that holds a parcel gives way by so much [m/s/N]: nothing against any speed that
#: counts, and large enough that the problem of `contact` stays well conditioned.
JAMMED_M_S_PER_N = 1e-7

#: A wheel without inertia or damping that coasts would answer to a force without limit.
LOSS_MIN_N_S_PER_M = 1e-6

# Under the ideal law -----------------------------------------------------------------------------


@compiled
def draw_ideal_lines(scene: Scene, reference_m_s: Floats) -> None:
    """Each support's push f = clip(a r - b u, -mu N, mu N) (eqs 9 and 12).

    With viscous sliding, f = mu_v N (v - u) joined with f = a r - b v, no clip.
    """
    scratch = scene.scratch
    for p in range(scratch.parcels.size):
        body = scratch.parcels[p]
        for i in range(body.first, body.first + body.supports):
            w = scratch.support[i]
            wheel, line = scene.model.wheels[w], scratch.line[body.first + i]
            normal_n = scratch.normal_n[i]
            stall, slope = wheel.a * reference_m_s[w], wheel.b
            if wheel.viscous_s_per_m > 0.0:
                film = wheel.viscous_s_per_m * normal_n
                share = film / (film + slope)
                set_line(line, share * stall, share * slope, np.inf)
            else:
                set_line(line, stall, slope, wheel.friction * normal_n)
        draw_roller_lines(scene, p, 0.0, 0.0)


@compiled
def spin_ideal(scene: Scene, reference_m_s: Floats, step_s: float) -> None:
    """Massless wheels run at the speed at which the motor's force is the push: f = a r - b v."""
    for w in range(scene.model.wheels.size):
        wheel, now = scene.model.wheels[w], scene.state.wheels[w]
        now.speed_m_s = (wheel.a * reference_m_s[w] - now.force_n) / wheel.b
        now.travel_m += step_s * now.speed_m_s


# Under voltage -----------------------------------------------------------------------------------


@compiled
def power_wheels(scene: Scene, voltage_v: Floats, step_s: float) -> None:
    """Work out how each wheel will answer to its voltage over the step (eq 8).

    A current beyond the limit is held there instead: the motor then pushes evenly. A motor that its
    bridge leaves open carries no current; one behind a jammed wheel that of a stall.
    """
    for w in range(scene.model.wheels.size):
        wheel, now, answer = scene.model.wheels[w], scene.state.wheels[w], scene.scratch.wheels[w]
        if now.jammed:
            now.speed_m_s = 0.0
        volts = applied_voltage(voltage_v[w], now.supply_v, wheel.pwm_steps)
        drive_n, braking = wheel.force_per_volt * volts, wheel.loss - wheel.damping
        torque_n = drive_n - braking * now.speed_m_s
        if abs(torque_n) > wheel.force_limit_n:
            drive_n, braking = np.copysign(wheel.force_limit_n, torque_n), 0.0
        if now.coasting:
            drive_n, braking = 0.0, 0.0
        answer.drive_n, answer.braking = drive_n, braking
        loss = max(wheel.damping + braking, LOSS_MIN_N_S_PER_M)
        answer.decay, answer.gain, answer.glide, answer.stride = coast(wheel.mass_kg, loss, step_s)
        if now.jammed:
            answer.decay, answer.gain, answer.glide, answer.stride = 0.0, JAMMED_M_S_PER_N, 0.0, 0.0


@compiled
def draw_voltage_lines(scene: Scene, step_s: float) -> None:
    """Each support's mean push over a step, as a line in the parcel's speed at its end.

    A wheel alone would go v+ = decay v + gain (F - f). Rolling is v+ = u+; viscous sliding is
    f = mu_v N (v + v+ - u - u+) / 2. The levers are those of halfway, so u+ = J xi+ + shift.
    """
    scratch = scene.scratch
    for p in range(scratch.parcels.size):
        body = scratch.parcels[p]
        vx, vy, yaw_rate = twist_of(scene, p)
        shift_x = -0.5 * step_s * yaw_rate * vy
        shift_y = 0.5 * step_s * yaw_rate * vx
        for i in range(body.first, body.first + body.supports):
            w, line = scratch.support[i], scratch.line[body.first + i]
            wheel, answer = scene.model.wheels[w], scratch.wheels[w]
            speed = scene.state.wheels[w].speed_m_s
            free = answer.decay * speed + answer.gain * answer.drive_n
            if scene.state.wheels[w].jammed:
                free = 0.0
            if wheel.viscous_s_per_m > 0.0:
                film = 0.5 * wheel.viscous_s_per_m * scratch.normal_n[i]
                slope = film / (1.0 + film * answer.gain)
                old = speed_over(scratch.jacobian[body.first + i], (vx, vy, yaw_rate))
                set_line(line, slope * (speed + free - old), slope, np.inf)
            else:
                shift = wheel.direction_x * shift_x + wheel.direction_y * shift_y
                limit = wheel.friction * scratch.normal_n[i]
                set_line(line, (free + shift) / answer.gain, 1.0 / answer.gain, limit)
        draw_roller_lines(scene, p, shift_x, shift_y)


@compiled
def spin_voltage(scene: Scene) -> None:
    """Wheels with inertia answer to motor and push, both constant over the step, exactly."""
    for w in range(scene.model.wheels.size):
        now, answer = scene.state.wheels[w], scene.scratch.wheels[w]
        force_n = answer.drive_n - now.force_n
        now.travel_m += answer.glide * now.speed_m_s + answer.stride * force_n
        now.speed_m_s = answer.decay * now.speed_m_s + answer.gain * force_n
        if now.jammed:
            now.speed_m_s = 0.0
        torque_n = answer.drive_n - answer.braking * now.speed_m_s
        now.current_a = torque_n / scene.model.wheels[w].force_per_ampere


# Under both --------------------------------------------------------------------------------------


@compiled
def draw_roller_lines(scene: Scene, p: int, shift_x: float, shift_y: float) -> None:
    """Rollers push against the parcel's motion along the axle, with mu_r N beyond their creep."""
    scratch, body = scene.scratch, scene.scratch.parcels[p]
    for i in range(body.first, body.first + body.lines - body.supports):
        row = body.first + body.supports + i
        limit = scene.model.wheels[scratch.support[i]].roller_friction * scratch.normal_n[i]
        slope = limit / CREEP_M_S
        shift = scratch.jacobian[row, 0] * shift_x + scratch.jacobian[row, 1] * shift_y
        set_line(scratch.line[row], slope * shift, slope, limit)


@compiled
def set_line(line: Floats, stall_n: float, slope: float, limit_n: float) -> None:
    """Fill in c, k and limit; a wheel without load gets a limit of zero and a harmless slope."""
    loaded = slope > 0.0
    line[0] = stall_n if loaded else 0.0
    line[1] = slope if loaded else 1.0
    line[2] = limit_n if loaded else 0.0


@compiled
def speed_over(row: Floats, twist: Vector) -> float:
    """Speed of a parcel along the direction of a row of its Jacobian."""
    return float(row[0] * twist[0] + row[1] * twist[1] + row[2] * twist[2])


@compiled
def push_wheels(scene: Scene, p: int, twist: Vector) -> None:
    """Set what each support of a parcel carries, how it pushes and whether it rolls."""
    scratch, body = scene.scratch, scene.scratch.parcels[p]
    for i in range(body.first, body.first + body.supports):
        wheel, line = scene.state.wheels[scratch.support[i]], scratch.line[body.first + i]
        wheel.normal_n = scratch.normal_n[i]
        wheel.force_n = push(line, scratch.jacobian[body.first + i], twist)
        wheel.contact = contact_of(wheel.normal_n, wheel.force_n, line[2])


@compiled
def set_slips(scene: Scene) -> None:
    """Set how fast each sliding support's surface runs ahead of its parcel."""
    scratch = scene.scratch
    for p in range(scratch.parcels.size):
        body = scratch.parcels[p]
        for i in range(body.first, body.first + body.supports):
            wheel = scene.state.wheels[scratch.support[i]]
            if wheel.contact > ROLLING:
                over = speed_over(scratch.jacobian[body.first + i], new_twist_of(scene, p))
                wheel.slip_m_s = wheel.speed_m_s - over


@compiled
def contact_of(normal_n: float, force_n: float, limit_n: float) -> int:
    """The contact code of a wheel; a viscous film (no limit) always slides."""
    if normal_n <= 0.0:
        return NONE
    if abs(force_n) < limit_n < np.inf:
        return ROLLING
    return FORWARD if force_n > 0.0 else BACKWARD
