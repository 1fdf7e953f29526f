"""What is done to parcels from outside: pushed, lifted, set down again; brought and taken away."""

from mdms_model.parcel import turned
from mdms_sim.physics.plane.records import Scene


def push(scene: Scene, p: int, impulse_n_s: tuple[float, float], twist_nms: float) -> bool:
    """Give parcel p an impulse through its centre of mass, and one about it [table frame].

    Returns False, and does nothing, while it is lifted.
    """
    now, body = scene.state.parcels[p], scene.model.parcels[p]
    if now.lifted:
        return False
    now.vx_m_s += impulse_n_s[0] / body.mass_kg
    now.vy_m_s += impulse_n_s[1] / body.mass_kg
    now.yaw_rate_rad_s += twist_nms / body.inertia_kg_m2
    return True


def lift(scene: Scene, p: int) -> None:
    """Take parcel p off the table: it stands still there, touches nothing and covers no sensor."""
    now = scene.state.parcels[p]
    now.lifted += 1
    now.vx_m_s = now.vy_m_s = now.yaw_rate_rad_s = 0.0


def set_down(
    scene: Scene, p: int, x_m: float | None, y_m: float | None, yaw_rad: float | None
) -> bool:
    """Put parcel p at rest where its origin is to be, None: where it was [table frame].

    Returns False while other hands still hold it.
    """
    now, body = scene.state.parcels[p], scene.model.parcels[p]
    arm_x, arm_y = turned(body.centre_x_m, body.centre_y_m, now.yaw_rad)
    x_m = now.x_m - arm_x if x_m is None else x_m
    y_m = now.y_m - arm_y if y_m is None else y_m
    now.yaw_rad = now.yaw_rad if yaw_rad is None else yaw_rad
    arm_x, arm_y = turned(body.centre_x_m, body.centre_y_m, now.yaw_rad)
    now.x_m, now.y_m = x_m + arm_x, y_m + arm_y
    now.lifted -= 1
    return bool(now.lifted == 0)


def take_away(scene: Scene, p: int) -> None:
    """Parcel p leaves: what carries on behind an exit has it, and it does not tip."""
    lift(scene, p)
    now = scene.state.parcels[p]
    now.away, now.tipped = 1, 0
    carried = scene.scratch.wheels["parcel"] == p
    for name in ("contact", "normal_n", "force_n", "slip_m_s"):
        scene.state.wheels[name][carried] = 0


def bring(scene: Scene, p: int, pose: tuple[float, float, float]) -> None:
    """Parcel p, which is away, comes: at rest where its origin is to be [table frame]."""
    set_down(scene, p, *pose)
    scene.state.parcels[p].away = 0
