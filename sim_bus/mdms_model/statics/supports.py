"""How a parcel's weight spreads over its supports: eq (1) of the paper, in the plane.

Every support is the same linear spring under a rigid flat bottom, so the normal force is a plane
N(x, y) = p0 + p1 x + p2 y over the supports; where the plane dips below zero the parcel lifts off
(no support pulls). In the row the plane is the line of eq (1), N = B^T (B B^T)^-1 [W, W x_c]^T.
"""

import numpy as np

from mdms_model.arrays import Floats
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
