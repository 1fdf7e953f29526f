"""What each wheel does to the parcel on it, as a clipped line, and what that does to the wheel."""

import numpy as np

from mdms_sim.physics.compiled import compiled
from mdms_sim.physics.contact import push
from mdms_sim.physics.motor import applied_voltage, coast
from mdms_sim.physics.scene import Scene
from mdms_sim.physics.symmetric3 import Vector
from mdms_sim.physics.wheels import Records
from mdms_sim.record import Contact, Floats

NONE, ROLLING = int(Contact.NONE), int(Contact.ROLLING)
FORWARD, BACKWARD = int(Contact.SLIDING_FORWARD), int(Contact.SLIDING_BACKWARD)


@compiled
def clear_wheels(wheels: Records) -> None:
    """No wheel carries anything until a parcel is found on it."""
    for w in range(wheels.size):
        wheels[w].normal_n = 0.0
        wheels[w].force_n = 0.0
        wheels[w].contact = NONE


@compiled
def draw_ideal_lines(scene: Scene, count: int, reference_m_s: Floats) -> None:
    """Each support's push f = clip(a r - b u, -mu N, mu N) (eqs 9 and 12).

    With viscous sliding, f = mu_v N (v - u) joined with f = a r - b v, no clip.
    """
    for i in range(count):
        w = scene.support[i]
        wheel = scene.wheels[w]
        stall, slope = wheel.a * reference_m_s[w], wheel.b
        limit = wheel.friction * scene.normal_n[i]
        film = wheel.viscous_s_per_m * scene.normal_n[i]
        if wheel.viscous_s_per_m > 0.0:
            share = film / (film + slope)
            stall, slope, limit = share * stall, share * slope, np.inf
        scene.line[i, 0], scene.line[i, 1], scene.line[i, 2] = stall, slope, limit


@compiled
def draw_voltage_lines(
    scene: Scene, count: int, twist: Vector, voltage_v: Floats, step_s: float
) -> None:
    """Each support's mean push over a step, as a line in the parcel's speed at its end.

    A wheel alone would go v+ = E v + g (F - f). Rolling is v+ = u+; viscous sliding is
    f = mu_v N (v + v+ - u - u+) / 2. The levers are those of halfway, so u+ = J xi+ + shift.
    """
    for i in range(count):
        w = scene.support[i]
        wheel = scene.wheels[w]
        decay, gain, _, _ = coast(wheel.mass_kg, wheel.loss, step_s)
        free = decay * wheel.speed_m_s + gain * motor_force(wheel, voltage_v[w])
        shift = (
            0.5 * step_s * twist[2] * (wheel.direction_x * twist[1] - wheel.direction_y * twist[0])
        )
        film = 0.5 * wheel.viscous_s_per_m * scene.normal_n[i]
        if wheel.viscous_s_per_m > 0.0:
            slope = film / (1.0 + film * gain)
            old = (
                scene.jacobian[i, 0] * twist[0]
                + scene.jacobian[i, 1] * twist[1]
                + scene.jacobian[i, 2] * twist[2]
            )
            scene.line[i, 0] = slope * (wheel.speed_m_s + free - old)
            scene.line[i, 1], scene.line[i, 2] = slope, np.inf
        else:
            scene.line[i, 0], scene.line[i, 1] = (free - shift) / gain, 1.0 / gain
            scene.line[i, 2] = wheel.friction * scene.normal_n[i]


@compiled
def push_wheels(scene: Scene, count: int, twist: Vector) -> None:
    """Tell each support what it carries, how it pushes and whether it rolls."""
    for i in range(count):
        wheel = scene.wheels[scene.support[i]]
        wheel.normal_n = scene.normal_n[i]
        wheel.force_n = push(scene.line[i], scene.jacobian[i], twist)
        wheel.contact = contact_of(wheel.force_n, scene.line[i, 2], wheel)


@compiled
def contact_of(force_n: float, limit_n: float, wheel: Records) -> int:
    """The contact code of a wheel that pushes with this force."""
    if wheel.normal_n <= 0.0:
        return NONE
    if abs(force_n) < limit_n and wheel.viscous_s_per_m <= 0.0:
        return ROLLING
    return FORWARD if force_n > 0.0 else BACKWARD


@compiled
def motor_force(wheel: Records, voltage_v: float) -> float:
    """Force at the rim of a blocked wheel, V Ke/Rm of eq (8) for what the bridge applies [N]."""
    volts = applied_voltage(voltage_v, wheel.supply_v, wheel.pwm_steps)
    return float(wheel.force_per_volt * volts)


@compiled
def spin_ideal(wheels: Records, reference_m_s: Floats, step_s: float) -> None:
    """Massless wheels run at the speed at which the motor's force is the push: f = a r - b v."""
    for w in range(wheels.size):
        wheel = wheels[w]
        wheel.speed_m_s = (wheel.a * reference_m_s[w] - wheel.force_n) / wheel.b
        wheel.travel_m += step_s * wheel.speed_m_s


@compiled
def spin_voltage(wheels: Records, voltage_v: Floats, step_s: float) -> None:
    """Wheels with inertia answer to motor and push, both constant over the step, exactly."""
    for w in range(wheels.size):
        wheel = wheels[w]
        decay, gain, coasting, travel = coast(wheel.mass_kg, wheel.loss, step_s)
        force_n = motor_force(wheel, voltage_v[w]) - wheel.force_n
        wheel.travel_m += coasting * wheel.speed_m_s + travel * force_n
        wheel.speed_m_s = decay * wheel.speed_m_s + gain * force_n
