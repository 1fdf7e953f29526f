"""The convex hull of points in the plane (Andrew's monotone chain)."""

import numpy as np

from mdms_model.arrays import Floats

#: Places that are this close to one line count as on it.
LINE_M = 1e-9


def convex_hull(points_m: Floats) -> Floats:
    """Corners of the hull of points (N, 2), counter-clockwise, shape (n, 2).

    Of points on one line these are its two ends, of equal ones it is one.
    """
    ordered = sorted(map(tuple, points_m.tolist()))
    lower, upper = _chain(ordered), _chain(ordered[::-1])
    return np.array([*lower[:-1], *upper[:-1]] or ordered[:1])


def _chain(ordered: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
    """The half of a hull that only turns left."""
    chain: list[tuple[float, ...]] = []
    for x_m, y_m in ordered:
        while len(chain) >= 2:
            (x0_m, y0_m), (x1_m, y1_m) = chain[-2], chain[-1]
            turn_m2 = (x1_m - x0_m) * (y_m - y0_m) - (y1_m - y0_m) * (x_m - x0_m)
            if turn_m2 > LINE_M**2:
                break
            chain.pop()
        chain.append((x_m, y_m))
    return chain
