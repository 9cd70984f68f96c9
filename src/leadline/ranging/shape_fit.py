"""A target's shape through measured points: robust Gauss-Newton on the distance of points from the surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leadline.samples import Array
from leadline.target import Cylinder, Sphere, Target

Mask = NDArray[np.bool_]

ITERATIONS = 30
MIN_COSINE = 0.2  # near the limb a ray grazes the surface and its point says little


@dataclass(frozen=True, slots=True)
class Points:
    """N points measured along rays: (N, 3) each, and the sigma (N,) along the ray."""

    origins_m: Array
    directions: Array
    length_m: Array
    sigma_m: Array

    @property
    def p_m(self) -> Array:
        return np.asarray(self.origins_m + self.length_m[:, None] * self.directions)

    def pick(self, keep: Mask) -> Points:
        return Points(self.origins_m[keep], self.directions[keep], self.length_m[keep], self.sigma_m[keep])


@dataclass(frozen=True, slots=True)
class Fit:
    """x = (position, shape), its covariance, which points agreed (N,), and the misfit (1: as the sigmas say)."""

    x: Array
    cov: Array
    agreed: Mask
    misfit: float


def first_guess(target: Target, points: Points) -> Array:
    """A start for the iteration, from the points' median and their plane."""
    p = points.p_m
    centre = np.median(p, axis=0)
    if isinstance(target, Sphere):
        radius = np.append(target.shape_mean, target.diameter_m or 0)[0] / (2 if target.diameter_m else 1)
        towards = centre / np.linalg.norm(centre)
        return np.concatenate([centre + 0.8 * radius * towards, target.shape_mean])
    if isinstance(target, Cylinder):
        return _best_axis(target, points, centre)
    return np.concatenate([_foot(p), target.shape_mean])


def _foot(p_m: Array) -> Array:
    """Foot of the perpendicular on the plane through points, robust to many wrong ones.

    A plane is m.p = 1, so over the distance of p it is linear in 1/distance, whose slopes, the directions, are right
    even where a match is wrong: least absolute deviations by reweighting cannot be levered.
    """
    nearness = 1 / np.linalg.norm(p_m, axis=1)
    directions = p_m * nearness[:, None]
    weight = np.ones(len(p_m))
    for _ in range(20):
        root = np.sqrt(weight)
        m = np.linalg.lstsq(directions * root[:, None], nearness * root, rcond=None)[0]
        weight = 1 / np.maximum(np.abs(nearness - directions @ m), 1e-3 * np.median(nearness))
    return np.asarray(m / (m @ m))


def _best_axis(target: Cylinder, points: Points, centre: Array) -> Array:
    """A cylinder's cost has several valleys: try the axis all around and keep the best start."""
    radius = target.radius_m(np.concatenate([np.zeros(3), target.shape_mean]))
    position = centre * (1 + 0.8 * radius / np.linalg.norm(centre))
    best, best_cost = np.empty(0), np.inf
    for angle in np.linspace(-np.pi / 2, np.pi / 2, 8, endpoint=False):
        x = np.concatenate([position, target.shape_mean])
        x[3] = angle
        x = _descend(target, points, x, np.ones(len(points.length_m)) * 0.02, 8)[0]
        cost = float(np.median(np.abs(target.distance(x, points.p_m)[0])))
        if cost < best_cost:
            best, best_cost = x, cost
    return best


def fit(target: Target, points: Points, guess: Array | None = None, roughness_m: float = 0.0) -> Fit | None:
    """The shape through the points, or None where they do not hold one.

    Robust: the scale starts at the points' own spread and comes down to their sigmas, and points beyond 4 sigma are
    left out at the end. A misfit above 1 widens the covariance.
    """
    if len(points.length_m) < 3 + len(target.shape_mean):
        return None
    x = first_guess(target, points) if guess is None else guess
    spread = 1.4826 * float(np.median(np.abs(target.distance(x, points.p_m)[0])))
    agreed = np.ones(len(points.length_m), bool)
    for floor in (max(spread, 1e-3), max(spread / 3, 1e-3), 0.0):
        sigma = np.hypot(_across(target, points, x), max(floor, roughness_m))
        x, _, ok = _descend(target, points, x, sigma, ITERATIONS)
        if not ok:
            return None
    sigma = np.hypot(_across(target, points, x), roughness_m)
    for _ in range(3):
        off = np.abs(target.distance(x, points.p_m)[0]) / sigma
        agreed = off < 4 * max(1.0, 1.4826 * float(np.median(off)))
        if agreed.sum() < 3 + len(target.shape_mean):
            return None
        x, information, ok = _descend(target, points.pick(agreed), x, sigma[agreed], ITERATIONS)
        if not ok:
            return None
    residual = target.distance(x, points.p_m[agreed])[0] / sigma[agreed]
    freedom = max(agreed.sum() - len(x), 1)
    misfit = float(np.sqrt(residual @ residual / freedom))
    few = 1 + 10 / freedom  # a misfit from few points is itself uncertain
    return Fit(x, np.linalg.inv(information) * max(misfit, 1.0) ** 2 * few, np.asarray(agreed, bool), misfit)


def _across(target: Target, points: Points, x: Array) -> Array:
    """Sigma (N,) across the surface of points whose error lies along their rays."""
    gradient = target.distance(x, points.p_m)[1][:, :3]
    norm = np.linalg.norm(gradient, axis=1)
    cosine = np.abs(np.einsum("ni,ni->n", gradient, points.directions)) / np.where(norm > 0, norm, 1)
    return np.asarray(points.sigma_m * np.maximum(cosine, MIN_COSINE))


def _descend(target: Target, points: Points, x: Array, sigma: Array, steps: int) -> tuple[Array, Array, bool]:
    """Gauss-Newton with Cauchy weights, and a weak prior on the estimated shape."""
    k = len(target.shape_mean)
    prior = np.concatenate([np.zeros(3), 1 / target.shape_sigma**2]) if k else np.zeros(3)
    p = points.p_m
    information = np.eye(len(x))
    for _ in range(steps):
        distance, gradient = target.distance(x, p)
        u = distance / sigma
        weight = 1 / (sigma**2 * (1 + (u / 3) ** 2))
        information = (gradient * weight[:, None]).T @ gradient + np.diag(prior)
        pull = gradient.T @ (weight * distance)
        if k:
            pull[3:] += prior[3:] * (x[3:] - target.shape_mean)
        try:
            step = -np.linalg.solve(information, pull)
        except np.linalg.LinAlgError:
            return x, information, False
        limit = 0.3 * np.linalg.norm(x[:3])
        step *= min(1.0, limit / (np.linalg.norm(step[:3]) + 1e-12))
        x = x + step
        if not np.isfinite(x).all() or x[2] <= 0 or (isinstance(target, Sphere) and target.radius_m(x) <= 0.01):
            return x, information, False
        if np.linalg.norm(step) < 1e-7:
            break
    return x, information, bool(np.linalg.cond(information) < 1e12)
