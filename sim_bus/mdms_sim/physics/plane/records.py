"""The arrays that the compiled steps work on, and the motion of parcels from and into them.

A step reads the model, moves the state, and writes the scratch before it reads it; so a copy of the
state is all that it takes to go back, or to try what would happen.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdms_model.array import Grid, build_wheels, reach_m
from mdms_model.arrays import Floats, Ints, Records
from mdms_model.compiled import compiled
from mdms_model.motor import drive_of, rim_mass_kg
from mdms_model.parcel import parcel_records, turned
from mdms_model.scenario.scenario import Cell, Parcel, Scenario, in_stock
from mdms_model.symmetric3 import Vector
from mdms_sim.physics.motor import true_cells

#: Convex parcels in the plane have at most six neighbours on average, and two points with each.
TOUCHES_PER_PARCEL = 6
NOBODY = -1
#: The counters of a step: touches listed, those without room, parcels and touches whose forces were
#: not found in the rounds allowed.
NOW, DROPPED, UNSOLVED, UNBALANCED = range(4)

WHEEL = np.dtype(
    [
        ("x_m", "f8"),
        ("y_m", "f8"),
        ("direction_x", "f8"),
        ("direction_y", "f8"),
        ("friction", "f8"),
        ("viscous_s_per_m", "f8"),
        ("roller_friction", "f8"),
        ("a", "f8"),  # N s/m, eq (9)
        ("b", "f8"),  # N s/m, eq (9)
        # Only wheels under voltage need the rest.
        ("force_per_volt", "f8"),  # Ke/Rm, eq (8) [N/V]
        ("force_per_ampere", "f8"),  # Ke [N/A]
        ("loss", "f8"),  # Be + Ke^2/Rm, eq (8) [N s/m]
        ("damping", "f8"),  # Be [N s/m]
        ("force_limit_n", "f8"),  # Ke times the current limit
        ("mass_kg", "f8"),  # inertia of rotor and wheel, felt at the rim
        ("pwm_steps", "i8"),
    ],
    align=True,
)
WHEEL_STATE = np.dtype(
    [
        ("speed_m_s", "f8"),
        ("travel_m", "f8"),
        # As the last step left them.
        ("contact", "i8"),
        ("normal_n", "f8"),
        ("force_n", "f8"),
        ("slip_m_s", "f8"),
        ("current_a", "f8"),  # of the motor, under voltage only
        ("supply_v", "f8"),
        ("coasting", "i8"),  # 1: its bridge leaves the motor open
        # Its faults, each the number of faults that say so.
        ("jammed", "i8"),  # wheel and motor stand, whatever the voltage
        ("reversed", "i8"),  # the motor's leads are swapped
        ("encoder_stuck", "i8"),
        ("missed_m", "f8"),  # travel that a stuck encoder has not counted
    ],
    align=True,
)
WHEEL_SCRATCH = np.dtype(
    [
        ("parcel", "i8"),  # which lies on it; NOBODY if none
        # v+ = decay v + gain F, travel = glide v + stride F, F = drive - push.
        ("drive_n", "f8"),
        ("braking", "f8"),  # of the back-EMF [N s/m]; 0 while the current is limited
        ("decay", "f8"),
        ("gain", "f8"),
        ("glide", "f8"),
        ("stride", "f8"),
    ],
    align=True,
)
#: The values of a parcel's `tipped`: it stands, it tips in this step, and that has been noted.
STANDS, TIPS, TIPPED = 0, 1, 2
#: Position and velocity are those of the centre of mass.
PARCEL_STATE = np.dtype(
    [
        ("x_m", "f8"),
        ("y_m", "f8"),
        ("yaw_rad", "f8"),
        ("vx_m_s", "f8"),
        ("vy_m_s", "f8"),
        ("yaw_rate_rad_s", "f8"),
        ("tipped", "i8"),
        ("lifted", "i8"),  # off the table, by so many hands
        ("away", "i8"),  # 1: it is in stock, or has left by an exit; then it is lifted, too
    ],
    align=True,
)
#: Its share of the lists of supports and lines, the twist it settles to, what others press.
PARCEL_SCRATCH = np.dtype(
    [
        ("first", "i8"),
        ("supports", "i8"),
        ("lines", "i8"),
        ("new_vx_m_s", "f8"),
        ("new_vy_m_s", "f8"),
        ("new_yaw_rate_rad_s", "f8"),
        ("pressed_x_n", "f8"),
        ("pressed_y_n", "f8"),
        ("pressed_nm", "f8"),
    ],
    align=True,
)
#: Where two parcels may touch in this step.
TOUCH = np.dtype(
    [
        ("a", "i8"),
        ("b", "i8"),
        ("normal_x", "f8"),  # from a to b
        ("normal_y", "f8"),
        ("x_m", "f8"),
        ("y_m", "f8"),
        ("lever_a_m", "f8"),  # of the normal about the centres of mass
        ("lever_b_m", "f8"),
        ("gap_m", "f8"),
        ("target_m_s", "f8"),
        ("force_n", "f8"),
        ("held", "i8"),  # the two touch, and did in the last step
        ("fresh", "i8"),  # they began to touch in this step
    ],
    align=True,
)


class Model(NamedTuple):
    """What stays: places, constants, outlines."""

    grid: Grid
    first: Ints
    """First wheel of each cell, and past the last of all."""
    wheels: Records
    parcels: Records
    edges: Floats
    gravity_m_s2: float


class StepState(NamedTuple):
    """The start of a step."""

    wheels: Records
    parcels: Records
    order: Ints
    """Parcels by their left end."""
    partners: Ints
    """The pairs that touched in the last step, (n, 2)."""
    pairs: Ints
    """How many of them there are, (1,)."""
    piece: NDArray[np.int8]
    """The piece that each line ended on, where the next solution is looked for first, (2 W,)."""


class Scratch(NamedTuple):
    """The workspace of a step.

    The lists hold the supports of all parcels, one parcel after the other: each one's wheel, place
    from the centre of mass and normal force (W,); and their lines (2 W,), for each parcel first
    those of the drives, then of the rollers.
    """

    wheels: Records
    parcels: Records
    touches: Records
    tally: Ints
    """Counts of this step, (4,)."""
    support: Ints
    spot_m: Floats
    normal_n: Floats
    jacobian: Floats
    line: Floats


class Scene(NamedTuple):
    """All that a step reads and writes."""

    model: Model
    state: StepState
    scratch: Scratch


def build_scene(scenario: Scenario) -> Scene:
    """The arrays of a scenario at its start. Raises `ScenarioError` for impossible outlines."""
    cells, first = true_cells(scenario), build_wheels(scenario).first
    model = _model(scenario, cells)
    wheels, parcels = len(model.wheels), len(model.parcels)
    state = StepState(
        wheels=_records(wheels, WHEEL_STATE),
        parcels=_at_start(scenario.parcel, in_stock(scenario)),
        order=np.arange(parcels),
        partners=np.zeros((TOUCHES_PER_PARCEL * parcels, 2), dtype=np.int64),
        pairs=np.zeros(1, dtype=np.int64),
        piece=np.zeros(2 * wheels, dtype=np.int8),
    )
    for number, cell in enumerate(cells):
        state.wheels["supply_v"][first[number] : first[number + 1]] = cell.supply_v
    scratch = Scratch(
        wheels=_records(wheels, WHEEL_SCRATCH),
        parcels=_records(parcels, PARCEL_SCRATCH),
        touches=_records(TOUCHES_PER_PARCEL * parcels, TOUCH),
        tally=np.zeros(4, dtype=np.int64),
        support=np.zeros(wheels, dtype=np.int64),
        spot_m=np.zeros((wheels, 2)),
        normal_n=np.zeros(wheels),
        jacobian=np.zeros((2 * wheels, 3)),
        line=np.zeros((2 * wheels, 3)),
    )
    return Scene(model, state, scratch)


def _model(scenario: Scenario, cells: list[Cell]) -> Model:
    array, wheels = scenario.array, build_wheels(scenario)
    offsets = [wheel.offset_m for cell in cells for wheel in cell.wheel]
    records = _records(len(wheels.cell), WHEEL)
    records["x_m"], records["y_m"] = wheels.position_m.T
    records["direction_x"], records["direction_y"] = wheels.direction.T
    for number, cell in enumerate(cells):
        _fit(records[wheels.first[number] : wheels.first[number + 1]], cell)
    parcels, edges = parcel_records(scenario.parcel)
    return Model(
        grid=Grid(array.columns, array.rows, array.pitch_m, reach_m(offsets)),
        first=wheels.first,
        wheels=records,
        parcels=parcels,
        edges=edges,
        gravity_m_s2=scenario.run.gravity_m_s2,
    )


def _records(count: int, kind: "np.dtype[np.void]") -> Records:
    return np.zeros(count, dtype=kind).view(np.recarray)


def _at_start(parcels: tuple[Parcel, ...], stock: set[str]) -> Records:
    """Parcels at rest where the scenario puts them, but for those in stock."""
    records = starts_of(parcels)
    for record, parcel in zip(records, parcels, strict=True):
        record["away"] = record["lifted"] = int(parcel.name in stock)
    return records


def starts_of(parcels: Sequence[Parcel]) -> Records:
    """Parcels at rest where they start."""
    records = _records(len(parcels), PARCEL_STATE)
    for record, parcel in zip(records, parcels, strict=True):
        arm_x, arm_y = turned(*parcel.centre_of_mass_m, parcel.yaw_rad)
        record["x_m"], record["y_m"] = parcel.x_m + arm_x, parcel.y_m + arm_y
        record["yaw_rad"] = parcel.yaw_rad
    return records


def _fit(records: Records, cell: Cell) -> None:
    """Give all wheels of a cell its motor and surface."""
    drive = drive_of(cell)
    limit_a = np.inf if cell.current_limit_a is None else cell.current_limit_a
    records["friction"] = cell.friction
    records["viscous_s_per_m"] = cell.viscous_friction_s_per_m
    records["roller_friction"] = cell.roller_friction
    records["a"], records["b"] = drive.a, drive.b
    records["force_per_volt"] = drive.ke / cell.resistance_ohm
    records["force_per_ampere"] = drive.ke
    records["loss"] = drive.be + drive.ke**2 / cell.resistance_ohm
    records["damping"] = drive.be
    records["force_limit_n"] = drive.ke * limit_a
    records["mass_kg"] = rim_mass_kg(cell)
    records["pwm_steps"] = cell.pwm_steps


@compiled
def read_poses(constants: Records, parcels: Records, pose: Floats, twist: Floats) -> None:
    """Pose and twist (P, 3) of the origins from those of the centres of mass; NaN while away."""
    for p in range(parcels.size):
        centre, body = constants[p], parcels[p]
        if body.away:
            pose[p], twist[p] = np.nan, np.nan
            continue
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
