"""How a parcel's weight spreads over its supports: eq (1) of the paper, in the plane and in a row.

Every support is the same linear spring under a rigid flat bottom, so the normal force is a plane
N(x, y) = p0 + p1 x + p2 y over the supports; where the plane dips below zero the parcel lifts off
(no support pulls). In the row the plane is the line of eq (1), N = B^T (B B^T)^-1 [W, W x_c]^T. As
the parcel moves along a row, its support set is constant over a stretch of positions, and its
forces are linear in them.
"""

from dataclasses import dataclass

import numpy as np

from mdms_model.arrays import Floats, Ints
from mdms_model.compiled import compiled
from mdms_model.symmetric3 import solve

#: Centre of mass this far outside the hull of the supports [m]: the parcel tips.
TIP_M = 1e-6
#: Share of the supports' own stiffness that holds up directions in which they have none.
REGULARISATION = 1e-13
ROUNDS = 50


@compiled
def press(spot_m: Floats, weight_n: float, normal_n: Floats) -> bool:
    """Spread a weight over supports (n, 2), seen from the centre of mass, into `normal_n` (n,) [N].

    Returns whether they balance it; False means that the parcel tips. Least squares as eq (1),
    with an active set: the minimum of sum N^2 under N >= 0 and equilibrium of force and moments.
    """
    normal_n[:] = 1.0
    plane = (0.0, 0.0, 0.0)
    for _ in range(ROUNDS):
        plane = _carrying_plane(spot_m, weight_n, normal_n)
        if not _lift(spot_m, plane, normal_n):
            break
    return _balances(spot_m, weight_n, normal_n)


@compiled
def _carrying_plane(
    spot_m: Floats, weight_n: float, normal_n: Floats
) -> tuple[float, float, float]:
    """The plane that balances the weight on those supports alone that carry so far (N > 0)."""
    count, sx, sy, sxx, sxy, syy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(normal_n.size):
        if normal_n[i] > 0.0:
            x, y = spot_m[i, 0], spot_m[i, 1]
            count += 1.0
            sx += x
            sy += y
            sxx += x * x
            sxy += x * y
            syy += y * y
    # Supports in a line, or fewer than three, leave some tilt free: hold it at none.
    hold = REGULARISATION * (sxx + syy) + np.finfo(np.float64).tiny
    return solve((count, sx, sy, sxx + hold, sxy, syy + hold), (weight_n, 0.0, 0.0))


@compiled
def _lift(spot_m: Floats, plane: tuple[float, float, float], normal_n: Floats) -> bool:
    """Set N to the plane, or to zero where it would pull; True when other supports carry now."""
    changed = False
    for i in range(normal_n.size):
        force = plane[0] + plane[1] * spot_m[i, 0] + plane[2] * spot_m[i, 1]
        carries = force > 0.0
        changed |= carries != (normal_n[i] > 0.0)
        normal_n[i] = force if carries else 0.0
    return changed


@compiled
def _balances(spot_m: Floats, weight_n: float, normal_n: Floats) -> bool:
    force, moment_x, moment_y = 0.0, 0.0, 0.0
    for i in range(normal_n.size):
        force += normal_n[i]
        moment_x += normal_n[i] * spot_m[i, 0]
        moment_y += normal_n[i] * spot_m[i, 1]
    bound = TIP_M * weight_n
    return (
        abs(moment_x) <= bound
        and abs(moment_y) <= bound
        and abs(force - weight_n) <= 1e-6 * weight_n
    )


EDGE_M = 1e-9
"""Positions closer than this are one: far below what a contact has, far above rounding."""


@dataclass(frozen=True, slots=True)
class Stretches:
    """The line cut where the support set changes.

    Between `edge_m[k]` and `edge_m[k + 1]` [m; centre of the parcel] the wheels `first[k]` to
    `last[k]` carry it. Where `first[k] > last[k]`, and outside, its centre of mass has supports on
    one side at most and it tips.
    """

    edge_m: Floats
    first: Ints
    last: Ints


def stretches_of(wheel_x_m: Floats, ends_m: tuple[float, float], com_m: float) -> Stretches:
    """Stretches of a parcel from the places of its ends and its centre of mass.

    `wheel_x_m` ascends; the rest is seen from the parcel's centre, along x.
    """
    back_m, front_m = ends_m
    if len(wheel_x_m) == 0 or front_m <= back_m:
        return Stretches(np.zeros(1), np.zeros(0, np.int64), np.zeros(0, np.int64))
    return Stretches(*cut(wheel_x_m, back_m, front_m, com_m))


@compiled
def cut(
    wheel_x_m: Floats, back_m: float, front_m: float, com_m: float
) -> tuple[Floats, Ints, Ints]:
    """The arrays of `Stretches`."""
    ends = np.sort(np.concatenate((wheel_x_m - front_m, wheel_x_m - back_m)))
    edge, first, last = [ends[0] - (front_m - back_m), ends[0]], [0], [-1]
    for cover in range(len(ends) - 1):
        right_m = ends[cover + 1]
        middle_m = (ends[cover] + right_m) / 2
        head = int(np.searchsorted(wheel_x_m, middle_m + back_m))
        tail = int(np.searchsorted(wheel_x_m, middle_m + front_m)) - 1
        while edge[-1] < right_m - EDGE_M:
            i, j, stop_m = support_set(wheel_x_m, head, tail, edge[-1] + com_m)
            if i != first[-1] or j != last[-1]:
                first.append(i)
                last.append(j)
                edge.append(edge[-1])
            edge[-1] = min(stop_m - com_m, right_m)
    return np.array(edge), np.array(first), np.array(last)


@compiled
def support_set(wheel_x_m: Floats, head: int, tail: int, com_x_m: float) -> tuple[int, int, float]:
    """The covered wheels `head` to `tail` that carry just right of `com_x_m`, and up to where.

    From left to right the parcel tips, lies on the two leftmost, on more, on all that it covers,
    on the rightmost only, and tips again.
    """
    if tail <= head or com_x_m >= wheel_x_m[tail] - EDGE_M:
        return 0, -1, np.inf
    if com_x_m < wheel_x_m[head] - EDGE_M:
        return 0, -1, wheel_x_m[head]
    for j in range(head + 1, tail):
        stop_m = unloading(wheel_x_m, head, j + 1, j + 1)
        if com_x_m < stop_m - EDGE_M:
            return head, j, stop_m
    for i in range(head, tail):
        stop_m = unloading(wheel_x_m, i, tail, i)
        if com_x_m < stop_m - EDGE_M:
            return i, tail, stop_m
    return 0, -1, np.inf


@compiled
def unloading(wheel_x_m: Floats, first: int, last: int, end: int) -> float:
    """Where the centre of mass is when supports `first` to `last` leave nothing on the one `end`.

    The zero of eq (1): 1/n + (x_c - mean) (x_end - mean) / spread = 0.
    """
    mean_m, spread_m2 = spread(wheel_x_m, first, last)
    place_m: float = mean_m - spread_m2 / ((last - first + 1) * (wheel_x_m[end] - mean_m))
    return place_m


@compiled
def spread(wheel_x_m: Floats, first: int, last: int) -> tuple[float, float]:
    """Mean place [m] of the supports and the sum of their squared distances from it [m^2]."""
    mean_m, square_m2 = 0.0, 0.0
    for i in range(first, last + 1):
        mean_m += wheel_x_m[i]
    mean_m /= last - first + 1
    for i in range(first, last + 1):
        square_m2 += (wheel_x_m[i] - mean_m) ** 2
    return mean_m, square_m2
