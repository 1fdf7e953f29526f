"""Parcels in the plane: ours beside MuJoCo on the same scene, cost per wheel, order of convergence.

18 cells with two wheels each carry one box along rigid fields, slow enough to roll and fast enough
to slip, at 1 ms. MuJoCo gets the wheels as hinged spheres, each pair with the box frictional along
the wheel's direction alone, and the proportional law as its velocity actuators. Errors of both are
against the paper's model written anew in numpy and integrated by scipy's DOP853 at its tightest.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from mdms_model.arrays import Floats
from mdms_model.motor import drive_of
from mdms_model.scenario.file import load_scenario
from mdms_model.scenario.scenario import Array, Parcel, Scenario
from mdms_sim.physics.plane.ideal import run_ideal
from mdms_sim.physics.plane.world import World

Row = dict[str, Any]

REPEATS = 7
STEP_S = 1e-3
#: Wheel inertia that MuJoCo needs to be stable; ours has none [kg m2, about the wheel's axle].
ARMATURE_KG_M2 = 1e-5
#: Rigid twists [m/s, m/s, rad/s] and how long they last [s].
FIELDS = {
    "rolling": ((0.03, 0.01, 0.15), 2.0),
    "slipping": ((0.6, 0.2, 3.0), 0.25),
}


def run() -> list[Row]:
    """All rows of the table."""
    # All cells alike: neither MuJoCo's scene nor the independent truth has spreads.
    scenario = load_scenario("array18", ["cell.motor_spread=0", "cell.friction_spread=0"])
    rows = [row for name in FIELDS for row in beside_mujoco(scenario, name)]
    return [*rows, *cost_per_wheel(scenario), *order_of_convergence(scenario)]


def references(scenario: Scenario, twist: tuple[float, float, float]) -> Floats:
    """References that roll a parcel along a rigid field, (b/a) J xi."""
    wheels = World(scenario).wheels
    vx, vy, yaw_rate = twist
    x, y = wheels.position_m.T
    field = np.column_stack([vx - yaw_rate * y, vy + yaw_rate * x])
    speeds: Floats = (field * wheels.direction).sum(axis=1) / drive_of(scenario.cell).droop
    return speeds


def best_of(repeats: int, trial: Callable[[], object]) -> float:
    """The shortest wall time of a few trials [s]."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        trial()
        times.append(time.perf_counter() - start)
    return min(times)


def end_pose(scenario: Scenario, reference: Floats, duration_s: float, step_s: float) -> Floats:
    """Where our parcel is in the end."""
    world, steps = World(scenario), round(duration_s / step_s)
    run_ideal(world, reference, step_s, steps, steps)
    pose: Floats = world.pose[0]
    return pose


# Independent truth -------------------------------------------------------------------------------


def integrated_pose(scenario: Scenario, reference: Floats, duration_s: float) -> Floats:
    """Where the box is in the end by eqs (1), (9) and (12) as an ordinary differential equation."""
    from scipy.integrate import solve_ivp

    parcel = scenario.parcel[0]
    start = [parcel.x_m, parcel.y_m, parcel.yaw_rad, 0.0, 0.0, 0.0]
    slope = acceleration(scenario, reference)
    done = solve_ivp(slope, (0.0, duration_s), start, method="DOP853", rtol=1e-10, atol=1e-12)
    pose: Floats = done.y[:3, -1]
    return pose


def acceleration(scenario: Scenario, reference: Floats) -> Callable[[float, Floats], Floats]:
    """The right side of the equations of motion in pose and twist."""
    cell, parcel, wheels = scenario.cell, scenario.parcel[0], World(scenario).wheels
    drive, half = drive_of(cell), np.array([parcel.length_m, parcel.width_m]) / 2
    mass = parcel.mass_kg
    inertia = np.array([mass, mass, mass * (half**2).sum() / 3])
    load = np.array([mass * scenario.run.gravity_m_s2, 0.0, 0.0])

    def slope(_: float, state: Floats) -> Floats:
        arm = wheels.position_m - state[:2]
        turn = np.array(
            [[np.cos(state[2]), -np.sin(state[2])], [np.sin(state[2]), np.cos(state[2])]]
        )
        under = (np.abs(arm @ turn) <= half).all(axis=1)
        arm, along = arm[under], wheels.direction[under]
        normal_n = np.linalg.pinv(np.column_stack([np.ones(len(arm)), arm]).T) @ load
        if normal_n.min() < 0.0:
            raise ValueError(f"a wheel pulls with {normal_n.min()} N; take a field that tips none")
        lever = arm[:, 0] * along[:, 1] - arm[:, 1] * along[:, 0]
        rows = np.column_stack([along, lever])
        wanted = drive.a * reference[under] - drive.b * (rows @ state[3:])
        limit = cell.friction * normal_n
        force_n = np.clip(wanted, -limit, limit)
        return np.concatenate([state[3:], rows.T @ force_n / inertia])

    return slope


# Beside MuJoCo -----------------------------------------------------------------------------------


def beside_mujoco(scenario: Scenario, field: str) -> list[Row]:
    """Steps per second and errors of both."""
    twist, duration_s = FIELDS[field]
    reference, steps = references(scenario, twist), round(duration_s / STEP_S)
    truth = integrated_pose(scenario, reference, duration_s)
    worlds = iter([World(scenario) for _ in range(REPEATS)])
    ours_s = best_of(REPEATS, lambda: run_ideal(next(worlds), reference, STEP_S, steps, steps))
    peer, peer_s = mujoco_pose(scenario, reference, steps)
    ours_per_s, peer_per_s = steps / ours_s, steps / peer_s
    ours_error = np.abs(end_pose(scenario, reference, duration_s, STEP_S) - truth)
    peer_error = np.abs(peer - truth)
    name = f"18 cells, one box, {field}"
    return [
        {
            "name": f"{name}: speed, beside MuJoCo",
            "ours": ours_per_s,
            "peer": peer_per_s,
            "ratio": ours_per_s / peer_per_s,
            "unit": "steps/s",
        },
        {
            "name": f"{name}: error after {duration_s:g} s",
            "ours": 1e3 * float(ours_error[:2].max()),
            "peer": 1e3 * float(peer_error[:2].max()),
            "ratio": float(peer_error[:2].max() / ours_error[:2].max()),
            "unit": "mm",
            "ours_yaw_rad": float(ours_error[2]),
            "peer_yaw_rad": float(peer_error[2]),
        },
    ]


def mujoco_pose(scenario: Scenario, reference: Floats, steps: int) -> tuple[Floats, float]:
    """Where MuJoCo's box is in the end, and the wall time of the shortest of three runs [s]."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(mujoco_scene(scenario))
    droop = drive_of(scenario.cell).droop
    poses: list[Floats] = []

    def trial() -> None:
        data = mujoco.MjData(model)
        for _ in range(500):  # let the box sink into its soft supports first
            mujoco.mj_step(model, data)
        data.qpos[-7:-5] = scenario.parcel[0].x_m, scenario.parcel[0].y_m
        data.qvel[:] = 0.0
        data.ctrl[:] = droop * reference / scenario.cell.wheel_radius_m
        nonlocal took_s
        start = time.perf_counter()
        for _ in range(steps):
            mujoco.mj_step(model, data)
        took_s = min(took_s, time.perf_counter() - start)
        x, y, _, w, _, _, z = data.qpos[-7:]
        poses.append(np.array([x, y, 2 * np.arctan2(z, w)]))

    took_s = np.inf
    for _ in range(3):
        trial()
    return poses[-1], took_s


def mujoco_scene(scenario: Scenario) -> str:
    """The same array and box in MuJoCo's own language."""
    cell, parcel, wheels = scenario.cell, scenario.parcel[0], World(scenario).wheels
    radius, gain = cell.wheel_radius_m, drive_of(cell).b * cell.wheel_radius_m**2
    bodies, pairs, motors = [], [], []
    for w, ((x, y), (ahead, aside)) in enumerate(
        zip(wheels.position_m, wheels.direction, strict=True)
    ):
        # Turning about -aside, ahead moves the top of the wheel along its direction.
        bodies.append(
            f'<body pos="{x} {y} 0"><joint name="j{w}" axis="{-aside} {ahead} 0" damping="0" '
            f'armature="{ARMATURE_KG_M2}"/><geom name="g{w}" type="sphere" size="{radius}" '
            f'mass="1e-4" contype="0" conaffinity="0"/></body>'
        )
        # A contact along z has its first tangent along y and its second along -x.
        along = f"{cell.friction * abs(aside) + 1e-5} {cell.friction * abs(ahead) + 1e-5}"
        pairs.append(f'<pair geom1="g{w}" geom2="box" condim="3" friction="{along} 0 0 0"/>')
        motors.append(f'<velocity joint="j{w}" kv="{gain}"/>')
    half = f"{parcel.length_m / 2} {parcel.width_m / 2} 0.02"
    return f"""
    <mujoco><option timestep="{STEP_S}" integrator="implicitfast" cone="elliptic"
      gravity="0 0 -{scenario.run.gravity_m_s2}"/><worldbody>{"".join(bodies)}
      <body pos="{parcel.x_m} {parcel.y_m} {radius + 0.02}"><freejoint/>
      <geom name="box" type="box" size="{half}" mass="{parcel.mass_kg}" contype="0"
        conaffinity="0"/></body></worldbody>
      <contact>{"".join(pairs)}</contact><actuator>{"".join(motors)}</actuator></mujoco>"""


# By ourselves ------------------------------------------------------------------------------------


def cost_per_wheel(scenario: Scenario) -> list[Row]:
    """Wall time per wheel and step, from one box on 36 wheels to a hundred on 3,600."""
    cost = {side: nanoseconds_per_wheel(tiled(scenario, side)) for side in (1, 2, 5, 10)}
    return [
        {
            "name": f"{36 * side**2} wheels, {side**2} boxes: cost per wheel",
            "ours": cost[side],
            "peer": None,
            "ratio": cost[side] / cost[1],
            "unit": "ns/step",
        }
        for side in cost
    ]


def tiled(scenario: Scenario, side: int) -> Scenario:
    """The array and its box repeated side x side times, as one larger array."""
    array, box = scenario.array, scenario.parcel[0]
    width_m, depth_m = array.columns * array.pitch_m, array.rows * array.pitch_m
    boxes = tuple(
        replace(
            box,
            name=f"{column}, {row}",
            x_m=box.x_m + (column - (side - 1) / 2) * width_m,
            y_m=box.y_m + (row - (side - 1) / 2) * depth_m,
        )
        for column in range(side)
        for row in range(side)
    )
    larger = Array(array.columns * side, array.rows * side, array.pitch_m)
    return replace(scenario, array=larger, parcel=boxes)


def nanoseconds_per_wheel(scenario: Scenario) -> float:
    """Wall time per wheel and step under a field that makes some wheels roll and some slip."""
    world = World(scenario)
    wheels, steps = len(world.wheels.cell), 2000 * 360 // len(world.wheels.cell)
    reference = np.where(np.arange(wheels) % 4 < 2, 0.1, -0.1)
    worlds = iter([world, *(World(scenario) for _ in range(REPEATS - 1))])
    wall_s = best_of(REPEATS, lambda: run_ideal(next(worlds), reference, 1e-4, steps, steps))
    return wall_s / wheels / steps * 1e9


def order_of_convergence(scenario: Scenario) -> list[Row]:
    """How fast the error falls with the step: between changes of supports, and over them."""
    box = Parcel("box", 2.0, 0.36, 0.30)
    rows = []
    for name, duration_s in (("same supports", 0.1), ("supports change", 1.0)):
        plain = replace(scenario, parcel=(box,))
        reference = references(plain, (0.05, 0.02, 0.2))
        truth = end_pose(plain, reference, duration_s, duration_s / 100_000)
        steps = [25, 50, 100, 200, 400]
        errors = [
            np.abs(end_pose(plain, reference, duration_s, duration_s / n) - truth).max()
            for n in steps
        ]
        slope = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
        rows.append(
            {
                "name": f"order of convergence, {name}",
                "ours": float(slope),
                "peer": None,
                "ratio": None,
                "unit": "",
                "error_mm": 1e3 * float(errors[-1]),
            }
        )
    return rows
