"""How the wheels under a parcel share a push: each in proportion to its normal force.

Wheel i carries N_i and pushes along j_i = (d_x, d_y, lever about the centre of mass). The wrench W
is given by f_i = N_i (j_i . lambda) with lambda = (sum N_i j_i j_i^T)^-1 W. So of all wheels that
push the same way none slips before the others.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mdms_host.estimation.footprint import Footprint
from mdms_host.layout import Layout
from mdms_model.arrays import Bools, Floats, Ints
from mdms_model.outline import area_and_moment, polygon_outline

#: Assumed mass of a parcel of unknown mass [kg].
UNKNOWN_KG = 1.0


@dataclass(frozen=True, slots=True)
class Mass:
    """Mass, moment of inertia about its centre, and that centre in the parcel's own frame."""

    mass_kg: float
    inertia_kg_m2: float
    centre_m: tuple[float, float] = (0.0, 0.0)


def uniform_mass(outline: Footprint, mass_kg: float = UNKNOWN_KG) -> Mass:
    """That of an even plate of this outline."""
    corners_m = outline.outline_m(np.zeros(3))
    area_m2, moment_m3 = area_and_moment(corners_m)
    x_m, y_m = (moment_m3 / area_m2).tolist()
    return Mass(mass_kg, mass_kg * polygon_outline(corners_m).moment_m2, (x_m, y_m))


def centre_at(mass: Mass, poses: Floats) -> Floats:
    """From the origin to the centre of mass at poses (K, 3) [m; table frame], shape (K, 2)."""
    cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    along_m, across_m = mass.centre_m
    return np.column_stack((cosine * along_m - sine * across_m, sine * along_m + cosine * across_m))


#: Share of the supports' own stiffness that holds up directions in which they have none.
_REGULARISATION = 1e-13
#: Each round may take supports away that would pull.
_ROUNDS = 20


class Spots(NamedTuple):
    """Wheels seen from the centre of mass [m], and which of them are under the parcel, (K, n)."""

    x_m: Floats
    y_m: Floats
    under: Bools


def normal_forces_n(spots: Spots, weight_n: float) -> Floats:
    """Normal forces (K, n) of n wheels at K poses: a plane over the supports; none of them pulls.

    A parcel that its supports do not balance is not noticed here.
    """
    x_m, y_m, under = spots
    terms = np.stack((np.ones_like(x_m), x_m, y_m, x_m * x_m, x_m * y_m, y_m * y_m), axis=-1)
    carrying = under
    for _ in range(_ROUNDS):
        plane = _carrying_plane(np.einsum("kn,knt->kt", carrying, terms), weight_n)
        force_n = plane[:, :1] + plane[:, 1:2] * x_m + plane[:, 2:] * y_m
        carries = under & (force_n > 0.0)
        if (carries == carrying).all():
            break
        carrying = carries
    return np.where(carrying, force_n, 0.0)


def _carrying_plane(sums: Floats, weight_n: float) -> Floats:
    """The planes (K, 3) that balance the weight on supports with these sums (K, 6)."""
    count, sx, sy, sxx, sxy, syy = sums.T
    hold = _REGULARISATION * (sxx + syy) + np.finfo(np.float64).tiny
    # L D L^T as in `symmetric3.solve`, for right sides (weight, 0, 0).
    d0 = np.maximum(count, 1.0)
    low10, low20 = sx / d0, sy / d0
    d1 = sxx + hold - low10 * sx
    low21 = (sxy - low20 * sx) / d1
    d2 = syy + hold - low20 * sy - low21 * low21 * d1
    y1 = -low10 * weight_n
    y2 = -low20 * weight_n - low21 * y1
    z = y2 / d2
    y = y1 / d1 - low21 * z
    return np.stack((weight_n / d0 - low10 * y - low20 * z, y, z), axis=-1)


#: Keeps the shares solvable where no wheel pushes (a row: neither along y nor round).
_RIDGE = 1e-9
#: Poses are worked on by so many, with the wheels near to them.
_AT_ONCE = 40


@dataclass(frozen=True, slots=True)
class Pushes:
    """Shares of wheels (n,) at poses (K, 3): their normal forces, and how they push.

    `wheels` are their numbers, `rows` (K, n, 3) their j_i [1, 1, m] and `normal_n` (K, n) their
    normal forces, of which `pushing_n` is carried by wheels that push. `per_wrench` (K, n, 3) maps
    a wrench (Fx, Fy, Mz about the centre of mass) [N, N, N m] to f_i / N_i of these. `arm_m` (K, 2)
    is from the parcel's origin to its centre of mass [m; table frame].
    """

    poses: Floats
    wheels: Ints
    rows: Floats
    normal_n: Floats
    pushing_n: Floats
    per_wrench: Floats
    arm_m: Floats
    mass: Mass

    def wrench(self, acceleration: Floats) -> Floats:
        """Wrench that accelerates the origin by (3,) or (K, 3) [m/s2, rad/s2] at each pose, (K, 3).

        The term of the square of the yaw rate is that of `turning_wrench`.
        """
        ax, ay, alpha = np.broadcast_to(acceleration, self.poses.shape).T
        mass, (arm_x, arm_y) = self.mass, self.arm_m.T
        force_x, force_y = ax - alpha * arm_y, ay + alpha * arm_x
        return np.column_stack(
            (mass.mass_kg * force_x, mass.mass_kg * force_y, mass.inertia_kg_m2 * alpha)
        )

    def wrench_at(self, sample: int, acceleration: Floats) -> Floats:
        """The same at one of the poses, shape (3,)."""
        ax, ay, alpha = acceleration.tolist()
        arm_x, arm_y = self.arm_m[sample].tolist()
        mass = self.mass
        return np.array(
            [
                mass.mass_kg * (ax - alpha * arm_y),
                mass.mass_kg * (ay + alpha * arm_x),
                mass.inertia_kg_m2 * alpha,
            ]
        )

    def inertia_kg(self, sample: int, along: Floats) -> float:
        """Generalised mass along a path at one of the poses, by metre of path."""
        force_x, force_y, moment = self.wrench_at(sample, along).tolist()
        mass = self.mass
        inertia_kg = (force_x**2 + force_y**2) / mass.mass_kg + moment**2 / mass.inertia_kg_m2
        return float(inertia_kg)

    def drag_n(self, sample: int, along: Floats, friction: float) -> float:
        """The most that wheels which carry and do not push drag with against a path at a pose."""
        passive_n = self.normal_n[sample] - self.pushing_n[sample]
        if not passive_n.any():
            return 0.0
        x, y, turn = along.tolist()
        arm_x, arm_y = self.arm_m[sample].tolist()
        per_m = abs(self.rows[sample] @ (x - turn * arm_y, y + turn * arm_x, turn))
        return friction * float(passive_n @ per_m)

    def turning_wrench(self) -> Floats:
        """Wrench that keeps the centre of mass on its circle, per square of yaw rate, (K, 3)."""
        return np.column_stack((-self.mass.mass_kg * self.arm_m, np.zeros(len(self.arm_m))))

    def shares(self, wrench: Floats) -> Floats:
        """f_i / N_i of the wheels that carry and push, for a wrench (K, 3) at each pose, (K, n)."""
        shares: Floats = np.einsum("knc,kc->kn", self.per_wrench, wrench)
        return np.where(self.pushing_n > 0.0, shares, 0.0)

    def dragging_wrench(self, direction: Floats, friction: float) -> Floats:
        """Wrench that overcomes the friction of wheels that carry and do not push, (K, 3)."""
        x, y, turn = direction.tolist()
        arm_x, arm_y = self.arm_m.T
        moving = np.column_stack((x - turn * arm_y, y + turn * arm_x, np.full(len(arm_x), turn)))
        passive_n = self.normal_n - self.pushing_n
        against_n = friction * passive_n * np.sign(np.einsum("knc,kc->kn", self.rows, moving))
        wrench: Floats = np.einsum("kn,knc->kc", against_n, self.rows)
        return wrench


def pushes_at(
    layout: Layout,
    outline: Footprint,
    mass: Mass,
    poses: Floats,
    weight_n: float,
    *,
    passive: Bools | None = None,
) -> Pushes:
    """The shares of all wheels that are under the parcel at any of the poses (K, 3).

    Wheels that are `passive` (W,) carry, but do not push (None: all do).
    """
    low_m = poses[:, :2].min(axis=0) - outline.reach_m
    high_m = poses[:, :2].max(axis=0) + outline.reach_m
    places_m = layout.wheel_positions_m
    near = ((places_m >= low_m) & (places_m <= high_m)).all(axis=1).nonzero()[0]
    seen_m = places_m[near] - poses[:, None, :2]
    cosine, sine = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    own_m = np.stack(
        (
            cosine * seen_m[..., 0] + sine * seen_m[..., 1],
            cosine * seen_m[..., 1] - sine * seen_m[..., 0],
        ),
        axis=-1,
    )
    away_m = outline.distance_m(own_m.reshape(-1, 2), np.zeros(3)).reshape(own_m.shape[:2])
    arm_m = centre_at(mass, poses)
    levers_m = seen_m - arm_m[:, None, :]
    spots = Spots(levers_m[..., 0], levers_m[..., 1], away_m < 0.0)
    normal_n = normal_forces_n(spots, weight_n)
    directions = np.broadcast_to(layout.wheel_directions[near], levers_m.shape)
    turning_m = directions[..., 1] * levers_m[..., 0] - directions[..., 0] * levers_m[..., 1]
    rows = np.concatenate((directions, turning_m[..., None]), axis=-1)
    pushing_n = normal_n if passive is None else np.where(passive[near], 0.0, normal_n)
    per_wrench = _per_wrench(rows, pushing_n, outline.reach_m)
    return Pushes(poses, near, rows, normal_n, pushing_n, per_wrench, arm_m, mass)


def _per_wrench(rows: Floats, pushing_n: Floats, reach_m: float) -> Floats:
    """(K, n, 3). Levers are counted in reaches meanwhile, so that all columns are of one size."""
    rows = rows / (1.0, 1.0, reach_m)
    grip = np.einsum("kn,kni,knj->kij", pushing_n, rows, rows)
    trace = np.trace(grip, axis1=1, axis2=2)
    ridge = np.where(trace > 0.0, _RIDGE * trace, 1.0)
    inverse = np.linalg.inv(grip + ridge[:, None, None] * np.eye(3))
    per_wrench: Floats = rows @ inverse
    per_wrench[..., 2] /= reach_m
    return per_wrench


def by_parts(poses: Floats) -> Iterator[Floats]:
    """Poses in parts that are small enough to be near the same wheels; ends belong to both."""
    for first in range(0, max(len(poses) - 1, 1), _AT_ONCE):
        yield poses[first : first + _AT_ONCE + 1]
