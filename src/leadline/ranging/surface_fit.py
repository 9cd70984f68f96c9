"""An unknown surface: a local quadric through the patches around its nearest point."""

from __future__ import annotations

import numpy as np

from leadline.ranging.shape_fit import Fit, Points, widened
from leadline.samples import Array
from leadline.target import Surface

KERNEL = 0.35  # of the points' extent: how local the quadric is
MISMATCH_SIGMAS = 4.0
GRID = 41
CORRELATED = 6.0  # frames that share an error: the same patches bend the same quadric the same way
SLOPE = 1.0  # sigma expected of a target's tilt
CURVATURE = 2.0  # sigma expected of its curvature, over its extent


def fit_surface(points: Points, beam: tuple[Array, Array] | None) -> Fit | None:
    """x = (nearest point, bulge at the beam's hit), or None where the points hold no surface.

    Depth along the mean line of sight is a quadric in the two coordinates across it, fitted with weights that fall off
    around the nearest point (local regression), which is then searched for within the points' extent.
    """
    p = points.p_m
    if len(p) < 8:
        return None
    frame = _frame(np.median(p, axis=0))
    u = p @ frame.T
    start = u[np.argsort(u[:, 2])[: max(3, len(u) // 6)], :2].mean(axis=0)
    agreed = np.ones(len(p), bool)
    for _ in range(3):
        coefficients, cov, agreed = _quadric(u, points, start)
        nearest = _nearest(coefficients, u[agreed, :2])
        start = nearest[:2]
    terms = _terms(nearest[None, :2])[0]
    sigma2 = float(terms @ cov @ terms) + _model_error(coefficients, u[:, :2]) ** 2
    spread = np.ptp(u[agreed, :2], axis=0) / 10  # where on a flat place the nearest point is says little
    position_cov = frame.T @ np.diag([*(spread**2), sigma2]) @ frame
    position = frame.T @ nearest
    bulge, bulge_var = _bulge(coefficients, cov, frame, u[agreed, :2], position, beam)
    full = np.zeros((4, 4))
    full[:3, :3], full[3, 3] = position_cov, bulge_var
    full *= CORRELATED
    return Fit(np.append(position, bulge), full, agreed, 1.0)


def _frame(towards_m: Array) -> Array:
    """Rows: two directions across the line of sight, and the line of sight (3, 3)."""
    sight = towards_m / np.linalg.norm(towards_m)
    right = np.cross([0.0, 1.0, 0.0], sight)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(sight, right), sight])


def _terms(ab: Array) -> Array:
    """(N, 6) of the quadric at (N, 2)."""
    a, b = ab.T
    return np.stack([np.ones_like(a), a, b, a * a, a * b, b * b], axis=1)


def _quadric(u: Array, points: Points, centre: Array) -> tuple[Array, Array, Array]:
    """Coefficients (6,), covariance, and the points (N,) that agree; robust, local around ``centre``."""
    extent = float(np.ptp(u[:, :2], axis=0).max())
    kernel = np.exp(-0.5 * ((u[:, :2] - centre) ** 2).sum(axis=1) / (KERNEL * extent) ** 2)
    terms = _terms(u[:, :2])
    ridge = np.diag([0.0, *[1 / SLOPE**2] * 2, *[(extent / CURVATURE) ** 2] * 3])  # nothing steep from noise alone
    weight = kernel / points.sigma_m**2
    agreed = np.ones(len(u), bool)
    scale = 1.0
    for _ in range(6):
        information = (terms * (weight * agreed)[:, None]).T @ terms + ridge
        coefficients = np.linalg.solve(information, terms.T @ (weight * agreed * u[:, 2]))
        off = np.abs(u[:, 2] - terms @ coefficients) / points.sigma_m
        scale = max(1.0, 1.4826 * float(np.median(off[agreed])))
        agreed = off < MISMATCH_SIGMAS * scale
        if agreed.sum() < 8:
            agreed = off <= np.sort(off)[7]
    return coefficients, np.linalg.inv(information) * widened(points.shared, scale**2, agreed.sum()), agreed


def _model_error(coefficients: Array, ab: Array) -> float:
    """What a quadric may miss of a curved surface, m: a part of how far it bends within the kernel (a ball: 6 %)."""
    reach = KERNEL * float(np.ptp(ab, axis=0).max())
    return 0.1 * float(np.abs(coefficients[3] + coefficients[5])) * reach**2


def _nearest(coefficients: Array, extent: Array) -> Array:
    """(3,) the quadric's point nearest to the origin within the points' extent, in the frame of the line of sight."""
    low, high = extent.min(axis=0), extent.max(axis=0)
    centre, width = (low + high) / 2, (high - low) / 2
    best = np.empty(3)
    for _ in range(3):
        axes = [np.clip(centre[i] + width[i] * np.linspace(-1, 1, GRID), low[i], high[i]) for i in range(2)]
        ab = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        points = np.column_stack([ab, _terms(ab) @ coefficients])
        best = points[np.argmin(np.linalg.norm(points, axis=1))]
        centre, width = best[:2], width * 3 / GRID
    return best


def _bulge(
    coefficients: Array, cov: Array, frame: Array, extent: Array, position_m: Array, beam: tuple[Array, Array] | None
) -> tuple[float, float]:
    """How far behind the nearest point's tangent plane the beam meets the quadric, with variance."""
    unknown = 0.0, float(Surface().shape_sigma[0]) ** 2
    if beam is None:
        return unknown
    origin, direction = frame @ beam[0], frame @ beam[1]
    length = float(np.linalg.norm(position_m))
    for _ in range(20):
        hit = origin + length * direction
        length += float(_terms(hit[None, :2])[0] @ coefficients - hit[2]) / float(direction[2])
    outside = np.maximum(extent.min(axis=0) - hit[:2], hit[:2] - extent.max(axis=0)).max()
    plane = Surface().beam_length(np.append(position_m, 0.0), beam[0][None], beam[1][None])[0][0]
    terms = _terms(hit[None, :2])[0]
    variance = float(terms @ cov @ terms) + max(float(outside), 0.0) ** 2
    bulge = length - float(plane)
    return (bulge, variance) if np.isfinite(bulge) and variance < unknown[1] else unknown
