"""The rigid twist that most wheels under a parcel agree on; wheels that slip count little."""

import numpy as np

from mdms_model.arrays import Floats

Twist = tuple[float, float, float]

#: Wheels this far from the fit are taken to slip.
_SLIPPING_M_S = 0.003
_ROUNDS = 5
#: Keeps a fit solvable, and at zero, along what no wheel shows (a row shows neither y nor yaw).
_RIDGE = 1e-10
#: The nine sums of a round are of products of two of the columns (u, v, w, speed).
_LEFT = [0, 0, 0, 1, 1, 2, 3, 3, 3]
_RIGHT = [0, 1, 2, 1, 2, 2, 0, 1, 2]


def fit_twist(jacobian: Floats, speed_m_s: Floats, start: Twist) -> Twist:
    """Twist that explains the speeds of at least one wheel: least squares, reweighted in rounds.

    `jacobian`, of shape (W, 3), maps the twist to speeds, of shape (W,); its columns should be of
    one unit. An error e counts as 1 / (1 + (e / s)^2), s being one and a half of their median.
    """
    columns = np.vstack((jacobian.T, speed_m_s))
    u, v, w, speed = columns
    left, right = columns[_LEFT], columns[_RIGHT]
    middle = len(speed_m_s) // 2
    x, y, z = start
    for _ in range(_ROUNDS):
        squares = (speed - u * x - v * y - w * z) ** 2
        # The middle one, or the upper of the two.
        median = sorted(squares.tolist())[middle]
        weight = 1.0 / (max(_SLIPPING_M_S**2, 2.25 * median) + squares)
        # Summed one after the other, so that the result is the same on every machine.
        x, y, z = _solve((weight * left * right).cumsum(axis=1)[:, -1].tolist())
    return x, y, z


def _solve(sums: list[float]) -> Twist:
    """Solution of [[a b c] [b d e] [c e f]] (x y z) = (p q r), by L D L^T, with a ridge."""
    a, b, c, d, e, f, p, q, r = sums
    ridge = _RIDGE * (a + d + f)
    a, d, f = a + ridge, d + ridge, f + ridge
    low_b, low_c = b / a, c / a
    d, e, f, q, r = d - low_b * b, e - low_b * c, f - low_c * c, q - low_b * p, r - low_c * p
    low_e = e / d
    z = (r - low_e * q) / (f - low_e * e)
    y = (q - e * z) / d
    return (p - b * y - c * z) / a, y, z
