"""The rigid twist that most wheels under a parcel agree on; wheels that slip count little.

Compiled, since it is the one loop that the host runs through thousands of times a second. It is
compiled as it is imported, once per installation: in the midst of a run, cells would not wait.
"""

from collections.abc import Callable
from typing import TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Twist = tuple[float, float, float]
Function = TypeVar("Function", bound=Callable[..., object])

#: Wheels this far from the fit are taken to slip.
_SLIPPING_M_S = 0.003
_ROUNDS = 5
#: Keeps a fit solvable, and at zero, along what no wheel tells (a row tells neither y nor yaw).
_RIDGE = 1e-10


def _compiled(signature: str) -> Callable[[Function], Function]:
    """Compiles a function for these types, or finds it compiled, and leaves its type unchanged."""
    decorator = numba.njit(signature, cache=True, error_model="numpy")
    return cast("Callable[[Function], Function]", decorator)


@_compiled("f8(f8[::1])")
def _median(values: Floats) -> float:
    """The middle one, or the upper of the two; wheels are few, so it is not worth sorting them."""
    middle = len(values) // 2
    for value in values:
        less = equal = 0
        for other in values:
            less += other < value
            equal += other == value
        if less <= middle < less + equal:
            return float(value)
    return np.nan


@_compiled("UniTuple(f8, 3)(UniTuple(f8, 6), UniTuple(f8, 3))")
def _solve(matrix: tuple[float, float, float, float, float, float], right: Twist) -> Twist:
    """Solution of [[a b c] [b d e] [c e f]] (x y z) = (p q r), by L D L^T, with a ridge."""
    (a, b, c, d, e, f), (p, q, r) = matrix, right
    ridge = _RIDGE * (a + d + f)
    a, d, f = a + ridge, d + ridge, f + ridge
    low_b, low_c = b / a, c / a
    d, e, f, q, r = d - low_b * b, e - low_b * c, f - low_c * c, q - low_b * p, r - low_c * p
    low_e = e / d
    z = (r - low_e * q) / (f - low_e * e)
    y = (q - e * z) / d
    return (p - b * y - c * z) / a, y, z


@_compiled("UniTuple(f8, 3)(f8[:, ::1], f8[::1], UniTuple(f8, 3))")
def fit_twist(jacobian: Floats, speed_m_s: Floats, start: Twist) -> Twist:
    """Twist that explains the speeds of at least one wheel: least squares, reweighted in rounds.

    `jacobian`, of shape (W, 3), maps the twist to speeds, of shape (W,); its columns should be of
    one unit. An error e counts as 1 / (1 + (e / s)^2), s being one and a half of their median.
    """
    x, y, z = start
    squares = np.empty(len(speed_m_s))
    for _ in range(_ROUNDS):
        for wheel, (u, v, w) in enumerate(jacobian):
            squares[wheel] = (speed_m_s[wheel] - u * x - v * y - w * z) ** 2
        scale2 = max(_SLIPPING_M_S**2, 2.25 * _median(squares))
        a = b = c = d = e = f = p = q = r = 0.0
        for wheel, (u, v, w) in enumerate(jacobian):
            weight = 1.0 / (scale2 + squares[wheel])
            speed = weight * speed_m_s[wheel]
            p, q, r = p + u * speed, q + v * speed, r + w * speed
            a, b, c = a + weight * u * u, b + weight * u * v, c + weight * u * w
            d, e, f = d + weight * v * v, e + weight * v * w, f + weight * w * w
        x, y, z = _solve((a, b, c, d, e, f), (p, q, r))
    return x, y, z
