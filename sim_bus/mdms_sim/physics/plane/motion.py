"""How parcels move: their poses and twists, before, within and after a step."""

from mdms_model.arrays import Floats, Records
from mdms_model.compiled import compiled
from mdms_model.parcel import turned
from mdms_model.symmetric3 import Vector
from mdms_sim.physics.plane.records import Scene


@compiled
def read_poses(constants: Records, parcels: Records, pose: Floats, twist: Floats) -> None:
    """Pose and twist (P, 3) of the origins from those of the centres of mass."""
    for p in range(parcels.size):
        centre, body = constants[p], parcels[p]
        arm_x, arm_y = turned(centre.centre_x_m, centre.centre_y_m, body.yaw_rad)
        pose[p, 0] = body.x_m - arm_x
        pose[p, 1] = body.y_m - arm_y
        pose[p, 2] = body.yaw_rad
        twist[p, 0] = body.vx_m_s + body.yaw_rate_rad_s * arm_y
        twist[p, 1] = body.vy_m_s - body.yaw_rate_rad_s * arm_x
        twist[p, 2] = body.yaw_rate_rad_s


@compiled
def halfway(scene: Scene, p: int, step_s: float) -> Vector:
    """Pose of the centre of mass half a step ahead."""
    body = scene.state.parcels[p]
    return (
        body.x_m + 0.5 * step_s * body.vx_m_s,
        body.y_m + 0.5 * step_s * body.vy_m_s,
        body.yaw_rad + 0.5 * step_s * body.yaw_rate_rad_s,
    )


@compiled
def twist_of(scene: Scene, p: int) -> Vector:
    """Twist of the centre of mass."""
    body = scene.state.parcels[p]
    return body.vx_m_s, body.vy_m_s, body.yaw_rate_rad_s


@compiled
def new_twist_of(scene: Scene, p: int) -> Vector:
    """The twist that this step's problem is solved by."""
    body = scene.scratch.parcels[p]
    return body.new_vx_m_s, body.new_vy_m_s, body.new_yaw_rate_rad_s


@compiled
def move(scene: Scene, p: int, mean: Vector, after: Vector, step_s: float) -> None:
    """Carry a parcel along its mean twist and give it a new one."""
    body = scene.state.parcels[p]
    body.x_m += step_s * mean[0]
    body.y_m += step_s * mean[1]
    body.yaw_rad += step_s * mean[2]
    body.vx_m_s, body.vy_m_s, body.yaw_rate_rad_s = after
