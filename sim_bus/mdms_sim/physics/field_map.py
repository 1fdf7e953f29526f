"""The effect of a field on a parcel that is held still: forces over places, torque over yaws.

The wheels run while the parcel is held, so that the map shows the field alone. The fields of
Boehringer, Donald and MacDonald (squeeze, ICRA 1994) and Kavraki (elliptic, ICRA 1997) can be seen
here on wheels that are few and stand apart, and what wheels beside their cells' centres do to them.
Equilibria are places without a net force, by whether a parcel put beside them comes back.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum, IntEnum
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mdms_model.array import build_wheels
from mdms_model.arrays import Floats
from mdms_model.compiled import compiled
from mdms_model.motor import drive_of
from mdms_model.parcel import HeldParcel, covers, held_parcel, place_of, turned
from mdms_model.scenario.scenario import Array, Parcel, Scenario
from mdms_model.statics.supports import press
from mdms_sim.physics.motor import true_cells


class Law(IntEnum):
    """How the wheels push."""

    SLIDING = 0
    """All slip: mu N the way they turn (eq 4); with viscous friction mu_v N times their speed."""
    AT_REST = 1
    """The motors' force on what does not move, as far as friction carries it (eqs 9 and 12)."""


class RunningWheels(NamedTuple):
    """All wheels of an array that runs, (W, 2) and (W,)."""

    position_m: Floats
    direction: Floats
    push_n: Floats
    """a r, the force at which a wheel stalls."""
    drag: Floats
    """b."""
    friction: Floats
    viscous_s_per_m: Floats
    law: int


def running_wheels_of(scenario: Scenario, reference_m_s: Floats, law: Law) -> RunningWheels:
    """The array under references of shape (W,)."""
    wheels = build_wheels(scenario)
    cells = true_cells(scenario)
    drives = [drive_of(cells[cell]) for cell in wheels.cell]
    return RunningWheels(
        wheels.position_m,
        wheels.direction,
        np.array([drive.a for drive in drives]) * reference_m_s,
        np.array([drive.b for drive in drives]),
        np.array([cells[cell].friction for cell in wheels.cell]),
        np.array([cells[cell].viscous_friction_s_per_m for cell in wheels.cell]),
        int(law),
    )


@compiled
def wheel_push_n(table: RunningWheels, i: int, normal_n: float) -> float:
    """Force of wheel `i` along its direction on a body at rest."""
    stall_n: float = table.push_n[i]
    limit_n: float = table.friction[i] * normal_n
    grip: float = table.viscous_s_per_m[i] * normal_n
    drag: float = table.drag[i]
    if grip > 0.0:
        return stall_n * grip / (drag + grip if table.law == Law.AT_REST else drag)
    if table.law == Law.SLIDING and stall_n != 0.0:
        return math.copysign(limit_n, stall_n)
    return min(max(stall_n, -limit_n), limit_n)


@compiled
def held_force(
    table: RunningWheels, held: HeldParcel, x_m: float, y_m: float, yaw_rad: float
) -> tuple[float, float, float]:
    """Net force [N] and torque about the centre of mass [N m]; NaN where the parcel tips.

    `x_m`, `y_m` is the parcel's geometric centre.
    """
    arm_x, arm_y = turned(held.body.centre_x_m, held.body.centre_y_m, yaw_rad)
    com_x, com_y = x_m + arm_x, y_m + arm_y
    place = place_of(held.body, (com_x, com_y, yaw_rad))
    wheels = len(table.push_n)
    under, spot_m = np.empty(wheels, np.int64), np.empty((wheels, 2))
    count = 0
    for i in range(wheels):
        if covers(held.body, held.edges, place, table.position_m[i, 0], table.position_m[i, 1]):
            under[count] = i
            spot_m[count, 0] = table.position_m[i, 0] - com_x
            spot_m[count, 1] = table.position_m[i, 1] - com_y
            count += 1
    normal_n = np.empty(count)
    if not press(spot_m[:count], held.weight_n, normal_n):
        return math.nan, math.nan, math.nan
    force_x, force_y, torque = 0.0, 0.0, 0.0
    for j in range(count):
        i = under[j]
        push_n = wheel_push_n(table, i, normal_n[j])
        push_x, push_y = push_n * table.direction[i, 0], push_n * table.direction[i, 1]
        force_x += push_x
        force_y += push_y
        torque += spot_m[j, 0] * push_y - spot_m[j, 1] * push_x
    return force_x, force_y, torque


@compiled
def forces_at(
    table: RunningWheels, held: HeldParcel, x_m: Floats, y_m: Floats, yaw_rad: float
) -> Floats:
    """`held_force` over a grid of places, (ny, nx, 3)."""
    found = np.empty((len(y_m), len(x_m), 3))
    for row in range(len(y_m)):
        for column in range(len(x_m)):
            found[row, column] = held_force(table, held, x_m[column], y_m[row], yaw_rad)
    return found


@compiled
def settle(
    table: RunningWheels, held: HeldParcel, start: Floats, yaw_rad: float, first_m: float
) -> Floats:
    """Where a parcel creeps to along the force at one yaw, in steps that shrink from `first_m`."""
    x_m, y_m, step_m = start[0], start[1], first_m
    while step_m > 1e-6 * first_m:
        force_x, force_y, _ = held_force(table, held, x_m, y_m, yaw_rad)
        if math.isnan(force_x):
            break
        pull = math.hypot(force_x, force_y) + 0.02 * held.weight_n
        x_m += step_m * force_x / pull
        y_m += step_m * force_y / pull
        step_m *= 0.95
    return np.array([x_m, y_m])


ForcesAt = Callable[[Floats, Floats], Floats]
"""Forces (ny, nx, 2) [N] over places x (nx,) and y (ny,) [m]."""

ZOOMS = 12
WINDOW = 9
NEUTRAL_SHARE = 0.02
"""A stiffness below this share of the greatest one holds nothing."""


class Stability(Enum):
    """The way of a parcel that is put beside an equilibrium."""

    STABLE = "stable"
    SPIRAL = "spiral"
    """Drawn in with a curl: it comes to rest only where damping is stronger than the curl."""
    NEUTRAL = "neutral"
    """Pushed away along no direction and free along some, or going round."""
    SADDLE = "saddle"
    UNSTABLE = "unstable"


@dataclass(frozen=True, slots=True)
class PlaceRest:
    """A place without net force, and the stiffness [N/m] of the field about it."""

    x_m: float
    y_m: float
    kind: Stability
    stiffness_n_per_m: tuple[complex, ...]
    """Eigenvalues of the force's change with place; negative where it pulls back."""

    @property
    def alone(self) -> bool:
        """Whether no line of equilibria leads through it."""
        sizes = [abs(value) for value in self.stiffness_n_per_m]
        return min(sizes) > NEUTRAL_SHARE * max(sizes)


@dataclass(frozen=True, slots=True)
class TurnRest:
    """A yaw without torque."""

    yaw_rad: float
    stable: bool


def place_rests(x_m: Floats, y_m: Floats, force_n: Floats, forces_at: ForcesAt) -> list[PlaceRest]:
    """The equilibria on a map of forces (ny, nx, 2); on one line of places only x counts.

    Forces jump where supports change, so an equilibrium is where the force turns round, not only
    where it vanishes.
    """
    spacing_m = float(x_m[1] - x_m[0])
    flat = len(y_m) == 1
    found: list[PlaceRest] = []
    for middle_m in _candidates(x_m, y_m, force_n):
        zero_m = _zoom(middle_m, spacing_m, flat, forces_at)
        if zero_m is None or any(_near(zero_m, rest, spacing_m) for rest in found):
            continue
        fit = _fit(zero_m, spacing_m, flat, forces_at)
        if fit is not None:
            stiffness = np.linalg.eigvals(fit[1]).astype(np.complex128)
            x, y = zero_m.tolist()
            found.append(PlaceRest(x, y, _kind(stiffness), tuple(stiffness.tolist())))
    return found


def _candidates(x_m: Floats, y_m: Floats, force_n: Floats) -> Iterator[Floats]:
    """Middles of the meshes at whose corners every component of the force has both signs."""
    corners = _corners(force_n)
    with np.errstate(invalid="ignore"):
        spans = (corners.min(axis=0) <= 0.0) & (corners.max(axis=0) >= 0.0)
        moves = np.ptp(corners, axis=0) > 0.0
    components = 1 if len(y_m) == 1 else 2
    chosen = spans[..., :components].all(axis=-1) & moves[..., :components].any(axis=-1)
    for row, column in np.argwhere(chosen):
        y = y_m[0] if len(y_m) == 1 else (y_m[row] + y_m[row + 1]) / 2
        yield np.array([(x_m[column] + x_m[column + 1]) / 2, y])


def _corners(force_n: Floats) -> Floats:
    """The forces at the corners of every mesh, (2 or 4, rows, columns, 2)."""
    along = [force_n[:, :-1], force_n[:, 1:]]
    if len(force_n) == 1:
        return np.array(along)
    return np.array([part for side in along for part in (side[:-1], side[1:])])


def _zoom(middle_m: Floats, spacing_m: float, flat: bool, forces_at: ForcesAt) -> Floats | None:
    """Follow the zero of a plane through the forces into ever smaller windows."""
    half_m = spacing_m
    for _ in range(ZOOMS):
        fit = _fit(middle_m, half_m, flat, forces_at)
        if fit is None or (abs(fit[0] - middle_m) > half_m).any():
            return None
        middle_m, half_m = fit[0], half_m / 2
    return middle_m


def _fit(
    centre_m: Floats, half_m: float, flat: bool, forces_at: ForcesAt
) -> tuple[Floats, Floats] | None:
    """Zero and slope of the plane that fits the forces in a window best; None where it tips."""
    steps_m = np.linspace(-half_m, half_m, WINDOW)
    across_m = np.zeros(1) if flat else steps_m
    force_n = forces_at(centre_m[0] + steps_m, centre_m[1] + across_m)
    if not np.isfinite(force_n).all():
        return None
    size = 1 if flat else 2
    grid = np.stack(np.meshgrid(steps_m, across_m), axis=-1).reshape(-1, 2)[:, :size]
    design = np.column_stack([np.ones(len(grid)), grid])
    plane, *_ = np.linalg.lstsq(design, force_n.reshape(-1, 2)[:, :size], rcond=None)
    slope = np.asarray(plane[1:].T, dtype=np.float64)
    move_m, *_ = np.linalg.lstsq(slope, -plane[0], rcond=NEUTRAL_SHARE)
    zero_m = centre_m.copy()
    zero_m[:size] += move_m
    return zero_m, slope


def _kind(stiffness: NDArray[np.complex128]) -> Stability:
    least = NEUTRAL_SHARE * abs(stiffness).max()
    if (stiffness.real > least).any():
        return Stability.SADDLE if (stiffness.real < -least).any() else Stability.UNSTABLE
    if (stiffness.real >= -least).any():
        return Stability.NEUTRAL
    return Stability.SPIRAL if (abs(stiffness.imag) > least).any() else Stability.STABLE


def _near(place_m: Floats, rest: PlaceRest, spacing_m: float) -> bool:
    return bool(np.hypot(place_m[0] - rest.x_m, place_m[1] - rest.y_m) < spacing_m / 2)


def turn_rests(yaw_rad: Floats, torque_nm: Floats, nothing_nm: float) -> list[TurnRest]:
    """Yaws where the torque turns round; torques below `nothing_nm` are none.

    Stable where it falls through zero: a parcel turned further is turned back.
    """
    signs = np.where(abs(torque_nm) <= nothing_nm, 0.0, np.sign(torque_nm))
    marked = np.flatnonzero(np.isfinite(torque_nm) & (signs != 0.0))
    found = []
    for before, after in pairwise(marked.tolist()):
        if signs[before] == signs[after]:
            continue
        part = torque_nm[before] / (torque_nm[before] - torque_nm[after])
        yaw = yaw_rad[before] + part * (yaw_rad[after] - yaw_rad[before])
        found.append(TurnRest(float(yaw), bool(signs[before] > 0.0)))
    return found


POINTS_PER_PITCH = 24
MOST_POINTS = 241
YAWS = 361
NOTHING = 1e-9
"""A torque below this share of weight times length is none."""


@dataclass(frozen=True, slots=True)
class FieldMap:
    """Forces on a parcel over places of its centre at its yaw, and its torque over yaws.

    `force_n` (ny, nx, 2) [N] is NaN where the parcel tips; on one row of cells ny is 1. At each of
    `yaw_rad`, over a whole turn, the parcel is at `settled_m` (nyaw, 2): where the field holds it,
    or where the scenario puts it if the field holds it nowhere.
    """

    law: Law
    x_m: Floats
    y_m: Floats
    force_n: Floats
    places: tuple[PlaceRest, ...]
    yaw_rad: Floats
    settled_m: Floats
    turning_nm: Floats
    turns: tuple[TurnRest, ...]


def map_field(
    scenario: Scenario, parcel: Parcel, reference_m_s: Floats, law: Law = Law.SLIDING
) -> FieldMap:
    """Put a parcel everywhere on the array, under references of shape (W,)."""
    table, held = running_wheels_of(scenario, reference_m_s, law), held_parcel(scenario, parcel)
    x_m, y_m = _places(scenario.array, parcel)

    def forces(xs_m: Floats, ys_m: Floats) -> Floats:
        return forces_at(table, held, xs_m, ys_m, parcel.yaw_rad)[..., :2]

    force_n = forces(x_m, y_m)
    places = place_rests(x_m, y_m, force_n, forces)
    yaw_rad = np.linspace(-math.pi, math.pi, YAWS)
    settled_m = np.tile([parcel.x_m, parcel.y_m], (YAWS, 1))
    if (start_m := _start(parcel, places)) is not None:
        step_m = scenario.array.pitch_m / 4
        settled_m = np.array([settle(table, held, start_m, yaw, step_m) for yaw in yaw_rad])
    poses = np.column_stack([settled_m, yaw_rad])
    turning_nm = np.array([held_force(table, held, *pose)[2] for pose in poses])
    nothing_nm = NOTHING * held.weight_n * parcel.length_m
    return FieldMap(
        law=law,
        x_m=x_m,
        y_m=y_m,
        force_n=force_n,
        places=tuple(places),
        yaw_rad=yaw_rad,
        settled_m=settled_m,
        turning_nm=turning_nm,
        turns=tuple(turn_rests(yaw_rad, turning_nm, nothing_nm)),
    )


def _places(array: Array, parcel: Parcel) -> tuple[Floats, Floats]:
    """Places over the whole table, alike on both sides of its middle."""
    x_m = _axis(array.columns, array.pitch_m)
    return x_m, _axis(array.rows, array.pitch_m) if array.rows > 1 else np.array([parcel.y_m])


def _axis(cells: int, pitch_m: float) -> Floats:
    points = min(cells * POINTS_PER_PITCH, MOST_POINTS - 1) + 1
    return np.linspace(-cells * pitch_m / 2, cells * pitch_m / 2, points)


def _start(parcel: Parcel, places: list[PlaceRest]) -> Floats | None:
    """The equilibrium nearest to the parcel's place that draws it in; None where there is none."""
    here = np.array([parcel.x_m, parcel.y_m])
    drawn = [
        np.array([rest.x_m, rest.y_m])
        for rest in places
        if rest.kind in (Stability.STABLE, Stability.SPIRAL, Stability.NEUTRAL)
    ]
    return min(drawn, key=lambda place: float(np.hypot(*(place - here))), default=None)
