"""Linear algebra of at most three dimensions by hand: for matrices this small, calling NumPy is most of the work.

A symmetric matrix is (xx, xy, yy, xz, yz, zz), the lower triangle row by row. What has fewer dimensions is filled up
with a measurement that says nothing (``filled``).
"""

from __future__ import annotations

from math import nan, sqrt

import numpy as np

from leadline.samples import Array

Symmetric = tuple[float, float, float, float, float, float]
Vector = tuple[float, float, float]


def filled(M: Array, last: float) -> Symmetric:
    """Of a symmetric matrix (m, m), m <= 3; ``last`` on the diagonal where there is nothing."""
    rows = M.tolist()
    if len(rows) == 3:
        (a, _, _), (b, c, _), (d, e, f) = rows
        return a, b, c, d, e, f
    if len(rows) == 1:
        return rows[0][0], 0.0, last, 0.0, 0.0, last
    (a, _), (b, c) = rows
    return a, b, c, 0.0, 0.0, last


def cholesky(C: Symmetric) -> Symmetric | None:
    """The lower triangle L with L L' = C; None where C is no covariance."""
    xx, xy, yy, xz, yz, zz = C
    if not xx > 0:
        return None
    a = sqrt(xx)
    b, d = xy / a, xz / a
    yy -= b * b
    if not yy > 0:
        return None
    c = sqrt(yy)
    e = (yz - d * b) / c
    zz -= d * d + e * e
    return (a, b, c, d, e, sqrt(zz)) if zz > 0 else None


def inverse(C: Symmetric) -> Symmetric | None:
    """None where C is no covariance."""
    L = cholesky(C)
    if L is None:
        return None
    a, b, c, d, e, f = L
    a, c, f = 1 / a, 1 / c, 1 / f
    e = -e * c * f
    d = -(d * f * a) - e * b * a
    b = -b * a * c
    return a * a + b * b + d * d, b * c + d * e, c * c + e * e, d * f, e * f, f * f


def times(C: Symmetric, v: Vector) -> Vector:
    xx, xy, yy, xz, yz, zz = C
    x, y, z = v
    return xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z


def dot(v: Vector, w: Vector) -> float:
    return v[0] * w[0] + v[1] * w[1] + v[2] * w[2]


def trace(C: Symmetric, D: Symmetric) -> float:
    """Of the product."""
    return C[0] * D[0] + C[2] * D[2] + C[5] * D[5] + 2 * (C[1] * D[1] + C[3] * D[3] + C[4] * D[4])


def chi_square(off: Array, cov: Array) -> float:
    """The square of a difference (m,) in its covariance (m, m); NaN where that is none."""
    if len(off) > 3:
        return float(off @ np.linalg.solve(cov, off))
    C = inverse(filled(cov, 1.0))
    x, y, z = (*off.tolist(), 0.0, 0.0)[:3]
    return nan if C is None else dot((x, y, z), times(C, (x, y, z)))
