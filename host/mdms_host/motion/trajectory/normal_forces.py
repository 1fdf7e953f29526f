"""Normal force of each wheel under a parcel (eq 1 in the plane), for many poses at once.

The same as `mdms_model.statics.supports.press`, which is for one pose and compiled.
"""

from typing import NamedTuple

import numpy as np

from mdms_model.arrays import Bools, Floats

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
