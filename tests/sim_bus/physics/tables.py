"""Tables of the prototype's shape with parcels on them, and figures of their motion."""

import numpy as np

from mdms_model.scenario.scenario import Array, Cell, Parcel, Run, Scenario, Wheel

G_M_S2 = 9.81
PAIR = (Wheel(0.0, (-0.03, 0.0)), Wheel(np.pi / 2, (0.03, 0.0)))
TOGETHER = (Wheel(0.0), Wheel(np.pi / 2))
OMNI = tuple(
    Wheel(angle, (0.03 * np.cos(angle), 0.03 * np.sin(angle))) for angle in (0.1, 2.2, 4.3)
)
BOX = Parcel("box", 2.0, 0.36, 0.30)


def plane(*parcels, wheel=PAIR, columns=6, rows=3, **cell):
    return Scenario(
        "plane",
        Array(columns, rows),
        Cell(wheel=wheel, **cell),
        parcels or (BOX,),
        run=Run("ideal"),
    )


def rigid_speed(world, twist, about=(0.0, 0.0)):
    """Speed of a rigid field along every wheel, J xi."""
    arm = world.wheels.position_m - about
    field = np.column_stack([twist[0] - twist[2] * arm[:, 1], twist[1] + twist[2] * arm[:, 0]])
    return (field * world.wheels.direction).sum(axis=1)


def throw(world, *twists):
    """Gives every parcel a twist."""
    for body, twist in zip(world.scene.state.parcels, twists, strict=True):
        body["vx_m_s"], body["vy_m_s"], body["yaw_rate_rad_s"] = twist


def kinetic_j(world):
    bodies, constants = world.scene.state.parcels, world.scene.model.parcels
    speed2 = bodies["vx_m_s"] ** 2 + bodies["vy_m_s"] ** 2
    turning = constants["inertia_kg_m2"] * bodies["yaw_rate_rad_s"] ** 2
    return 0.5 * (constants["mass_kg"] * speed2 + turning).sum()
