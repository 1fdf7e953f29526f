"""Symmetric 3 x 3 linear systems, the only ones that a rigid body in the plane needs."""

from mdms_model.compiled import compiled

Symmetric = tuple[float, float, float, float, float, float]
Vector = tuple[float, float, float]


@compiled
def solve(matrix: Symmetric, right: Vector) -> Vector:
    """Solve A x = b for a positive definite A, given as its upper triangle row by row (L D L^T)."""
    a00, a01, a02, a11, a12, a22 = matrix
    l10, l20 = a01 / a00, a02 / a00
    d1 = a11 - l10 * a01
    l21 = (a12 - l20 * a01) / d1
    d2 = a22 - l20 * a02 - l21 * l21 * d1
    y0 = right[0]
    y1 = right[1] - l10 * y0
    y2 = right[2] - l20 * y0 - l21 * y1
    x2 = y2 / d2
    x1 = y1 / d1 - l21 * x2
    x0 = y0 / a00 - l10 * x1 - l20 * x2
    return x0, x1, x2
