"""A target's shape through measured points: robust Gauss-Newton on the distance of points from the surface."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from leadline.samples import Array
from leadline.target import Target

Mask = NDArray[np.bool_]

ITERATIONS = 30
NEAR, SETTLED = 1e-3, 1e-5  # steps, as a part of the distance
MIN_COSINE = 0.2  # near the limb a ray grazes the surface and its point says little
CAUCHY = 3.0  # sigmas at which a point counts half
OUTLIER = 4.0  # sigmas beyond which it does not count at all
CUTS = 6
MAX_CONDITION = 1e12


@dataclass(frozen=True, slots=True)
class Points:
    """N points measured along rays: (N, 3) each, and the sigma (N,) along the ray.

    shared: by how much what they have in common makes the variance of their mean larger (``layout.shared``).
    """

    origins_m: Array
    directions: Array
    length_m: Array
    sigma_m: Array
    shared: float = 1.0

    @property
    def p_m(self) -> Array:
        return np.asarray(self.origins_m + self.length_m[:, None] * self.directions)

    def pick(self, keep: Mask) -> Points:
        rays = self.origins_m[keep], self.directions[keep]
        return Points(*rays, self.length_m[keep], self.sigma_m[keep], self.shared)


@dataclass(frozen=True, slots=True)
class Fit:
    """x = (position, shape), its covariance, which points agreed (N,), and the misfit (1: as the sigmas say)."""

    x: Array
    cov: Array
    agreed: Mask
    misfit: float


def fit(target: Target, points: Points, guess: Array | None = None, roughness_m: float = 0.0) -> Fit | None:
    """The shape through the points, near a guess or, without one, anywhere; None where they do not hold one.

    Robust: the scale follows the points' own spread down to their sigmas, and points beyond 4 of it are left out at the
    end. A misfit above 1 widens the covariance.
    """
    if len(points.length_m) < 3 + len(target.shape_mean):
        return None
    if guess is not None:
        x = descend(target, points, guess, roughness_m)
        return None if x is None else trim(target, points, x, roughness_m)
    from leadline.ranging.consensus import start  # noqa: PLC0415  it is built on this module

    held = start(target, points)
    if held is None:
        return None
    x, mine = held
    found = trim(target, points.pick(mine), x, roughness_m)
    if found is None:
        return None
    agreed = mine.copy()
    agreed[mine] = found.agreed
    return Fit(found.x, found.cov, agreed, found.misfit)


def trim(target: Target, points: Points, x: Array, roughness_m: float = 0.0) -> Fit | None:
    """The shape from close by, by the points that agree with it; which they are is settled with it."""
    p, sigma = points.p_m, across(target, points, x, roughness_m)
    agreed = np.ones(len(sigma), bool)
    for _ in range(CUTS):
        distance, gradient = target.distance(x, p)
        u = distance / sigma
        before, agreed = agreed, np.abs(u) < OUTLIER * _scale(u[agreed])
        if np.count_nonzero(agreed) < len(x):
            return None
        step, information = _step(target, x, distance[agreed], gradient[agreed], sigma[agreed], 1.0)
        if step is None:
            return None
        x = x + step
        if (agreed == before).all() and np.abs(step[:3]).max() < SETTLED * x[2]:
            break
    axes = cv2.eigen(information)[1].ravel()  # the largest first
    if not target.possible(x) or not axes[0] < MAX_CONDITION * axes[-1]:
        return None
    residual = np.asarray(target.distance(x, p[agreed])[0] / sigma[agreed])
    freedom = max(len(residual) - len(x) * points.shared, 1.0)
    misfit2 = float(residual @ residual) / freedom
    mixed = (len(agreed) / len(residual)) ** 2  # among many that are wrong, some agree by chance
    factor = mixed * widened(points.shared, misfit2, freedom)
    return Fit(x, np.asarray(cv2.invert(information)[1] * factor, np.float64), agreed, float(np.sqrt(misfit2)))


def widened(shared: float, misfit2: float, freedom: float) -> float:
    """Factor of the covariance of points with errors of their own.

    What points share does not average out. A misfit above 1 is an error of each besides; from few points it is itself
    uncertain (Student's t, to first order).
    """
    return shared + max(misfit2 * (1 + 2 / freedom) - 1, 0.0)


def across(target: Target, points: Points, x: Array, roughness_m: float) -> Array:
    """Sigma (N,) across the surface of points whose error lies along their rays."""
    cosine = np.abs(np.einsum("ni,ni->n", target.normals(x, points.p_m), points.directions))
    return np.asarray(np.hypot(points.sigma_m * np.maximum(cosine, MIN_COSINE), roughness_m))


def descend(
    target: Target, points: Points, x: Array, roughness_m: float = 0.0, iterations: int = ITERATIONS
) -> Array | None:
    """Gauss-Newton with Cauchy weights of the points' own scale; None where it leads nowhere."""
    p, sigma = points.p_m, across(target, points, x, roughness_m)
    for iteration in range(iterations):
        if iteration == 2:  # from a start that was far off, the surface has turned by now
            sigma = across(target, points, x, roughness_m)
        distance, gradient = target.distance(x, p)
        step, _ = _step(target, x, distance, gradient, sigma, _scale(distance / sigma))
        if step is None:
            return None
        far = 0.3 * float(np.sqrt(x[:3] @ x[:3]))
        size = float(np.sqrt(step[:3] @ step[:3]))
        x = x + step * min(1.0, far / (size + 1e-12))
        if not (np.isfinite(x).all() and x[2] > 0):
            return None
        if size < NEAR * x[2]:  # the rest of the way is with those that agree
            break
    return x if target.possible(x) else None


def _scale(u: Array) -> float:
    """Of residuals over their sigmas, from their median: 1 where they are no larger than stated."""
    half = len(u) // 2
    return max(1.0, 1.4826 * float(np.partition(np.abs(u), half)[half]))


def _step(
    target: Target, x: Array, distance: Array, gradient: Array, sigma: Array, scale: float
) -> tuple[Array | None, Array]:
    """One step (None where the points do not fix the shape), and the information; a weak prior on what is estimated."""
    u = distance / (scale * CAUCHY * sigma)
    weighted = gradient.T / (sigma**2 * (1 + u**2))
    information, pull = weighted @ gradient, weighted @ distance
    if len(x) > 3:
        prior = 1 / target.shape_sigma**2
        information[range(3, len(x)), range(3, len(x))] += prior
        pull[3:] += prior * (x[3:] - target.shape_mean)
    solved, step = cv2.solve(information, pull[:, None])  # NumPy's takes thrice as long
    return (-np.asarray(step[:, 0], np.float64) if solved else None), information
