"""Where two rays meet, and how well: midpoint, then maximum likelihood on the pixels."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from leadline.geometry.arrays import as_rows
from leadline.samples import Array

View = Callable[[Array], tuple[Array, Array]]
"""Points (N, 3) of the common frame -> pixels (N, 2) and d(pixel)/d(point) (N, 2, 3)."""

_STEPS = 20
_SETTLED_M = 1e-10


def midpoints(origins_a_m: Array, directions_a: Array, origins_b_m: Array, directions_b: Array) -> Array:
    """The points (N, 3) halfway between two sets of rays at their closest; NaN where that is behind an origin."""
    apart = origins_b_m - origins_a_m
    cosine = np.einsum("ij,ij->i", directions_a, directions_b)
    along_a = np.einsum("ij,ij->i", directions_a, apart)
    along_b = np.einsum("ij,ij->i", directions_b, apart)
    # 1 - cosine^2 loses all digits for nearly parallel rays; the cross product keeps them.
    sine2 = np.sum(np.cross(directions_a, directions_b) ** 2, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        length_a = (along_a - cosine * along_b) / sine2
        length_b = (cosine * along_a - along_b) / sine2
        unseen = ~((length_a >= 0) & (length_b >= 0) & np.isfinite(length_a) & np.isfinite(length_b))
        points = (origins_a_m + directions_a * length_a[:, None] + origins_b_m + directions_b * length_b[:, None]) / 2
    points[unseen] = np.nan
    return np.asarray(points)


def triangulate(
    views: Sequence[View], pixels_px: Sequence[ArrayLike], start_m: Array, sigma_px: ArrayLike = 0.1
) -> tuple[Array, Array]:
    """Maximum-likelihood points (N, 3) and their covariance (N, 3, 3), m^2, from two or more views.

    Gauss-Newton from ``start_m`` on all pixel residuals. ``sigma_px``: standard deviation of each pixel coordinate, one
    number or one for each point (N,); ValueError below 0. The covariance is that of the pixels alone, sigma^2
    (J^T J)^-1, to first order. NaN where the start is NaN, where the step leaves the field of view, or where the views
    do not fix the point.
    """
    measured = [as_rows(q, 2) for q in pixels_px]
    points = np.array(start_m, dtype=np.float64)
    sigma = np.asarray(sigma_px, dtype=np.float64)
    if sigma.shape not in ((), (len(points),)) or not (sigma >= 0).all():
        raise ValueError(f"sigma_px: must be 0 or more, one number or one for each of {len(points)} points")
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        for _ in range(_STEPS):
            normal_matrix, gradient = _normal_equations(views, measured, points)
            step = np.einsum("nij,nj->ni", _inverse(normal_matrix), gradient)
            points += step
            if not np.any(np.abs(step) > _SETTLED_M):
                break
        normal_matrix, _ = _normal_equations(views, measured, points)
        return points, _inverse(normal_matrix) * (sigma**2).reshape(-1, 1, 1)


def _normal_equations(views: Sequence[View], measured: Sequence[Array], points_m: Array) -> tuple[Array, Array]:
    normal_matrix, gradient = np.zeros((len(points_m), 3, 3)), np.zeros((len(points_m), 3))
    for view, q in zip(views, measured, strict=True):
        predicted, jacobian = view(points_m)
        normal_matrix += np.einsum("nki,nkj->nij", jacobian, jacobian)
        gradient += np.einsum("nki,nk->ni", jacobian, q - predicted)
    return normal_matrix, gradient


def _inverse(matrices: Array) -> Array:
    """Inverses of symmetric (N, 3, 3) by cofactors; NaN where singular: one lost point must not lose the others."""
    a, b, c = matrices[:, :, 0], matrices[:, :, 1], matrices[:, :, 2]
    cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
    determinant = np.einsum("ni,ni->n", a, cofactors[:, 0])
    determinant = np.where(determinant > 0, determinant, np.nan)
    return np.asarray(cofactors / determinant[:, None, None])
