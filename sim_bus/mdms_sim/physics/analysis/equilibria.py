"""Where a map of forces has no net force, and whether a parcel put beside it comes back."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mdms_model.arrays import Floats

ForcesAt = Callable[[Floats, Floats], Floats]
"""Forces (ny, nx, 2) [N] over places x (nx,) and y (ny,) [m]."""

ZOOMS = 12
WINDOW = 9
NEUTRAL_SHARE = 0.02
"""A stiffness below this share of the greatest one holds nothing."""


class Kind(Enum):
    """What becomes of a parcel that is put beside an equilibrium."""

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
    kind: Kind
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


def _kind(stiffness: NDArray[np.complex128]) -> Kind:
    least = NEUTRAL_SHARE * abs(stiffness).max()
    if (stiffness.real > least).any():
        return Kind.SADDLE if (stiffness.real < -least).any() else Kind.UNSTABLE
    if (stiffness.real >= -least).any():
        return Kind.NEUTRAL
    return Kind.SPIRAL if (abs(stiffness.imag) > least).any() else Kind.STABLE


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
