"""Linear algebra of at most three dimensions by hand: for matrices this small, calling NumPy is most of the work."""

from __future__ import annotations

from math import sqrt

Factor = tuple[float, float, float, float, float, float]


def cholesky(C: list[list[float]]) -> Factor | None:
    """The lower triangle L with L L' = C, row by row; ones beyond the size of C. None where C is no covariance."""
    if not C[0][0] > 0:
        return None
    a = sqrt(C[0][0])
    if len(C) == 1:
        return a, 0.0, 1.0, 0.0, 0.0, 1.0
    b = C[1][0] / a
    cc = C[1][1] - b * b
    if not cc > 0:
        return None
    c = sqrt(cc)
    if len(C) == 2:
        return a, b, c, 0.0, 0.0, 1.0
    d = C[2][0] / a
    e = (C[2][1] - d * b) / c
    ff = C[2][2] - d * d - e * e
    return (a, b, c, d, e, sqrt(ff)) if ff > 0 else None
