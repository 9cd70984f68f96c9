"""One robust measurement update: iterated, with Student-t noise, behind a gate that reports what it turns away.

The noise's scale s is settled by the fixed-point iteration of Agamennoni, Nieto and Nebot 2012 ("Approximate inference
in state-space models with heavy-tailed noise"). In axes T that make the measurement's covariance the identity and the
predicted one diagonal (a), each step of it is a sum over few numbers, and nothing is solved twice.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import sqrt

import numpy as np

from leadline.estimation.small import cholesky
from leadline.samples import Array

RELINEARISED = 5  # at most, where h is curved over the state's spread
SETTLED = 0.02  # of the measurement's sigma: h is straight enough
SCALE_STEPS, SCALE_SETTLED = 20, 1e-4

Linear = Callable[[Array], tuple[Array, Array, float] | None]
"""y -> h(y) (m,), its Jacobian (m, n) and what the curvature adds to the noise; None where y cannot give it at all."""


@dataclass(frozen=True, slots=True)
class Refused:
    reason: str
    nis: float | None = None


@lru_cache
def gate_threshold(dof: int, sigmas: float) -> float:
    """Chi-square value whose tail equals that of ``sigmas`` of a normal (Wilson and Hilferty 1931)."""
    spread = 2 / (9 * dof)
    return dof * (1 - spread + sigmas * sqrt(spread)) ** 3


def update(
    y: Array, P: Array, z: Array, cov: Array, linear: Linear, gate_sigmas: float, nu: float
) -> tuple[Array, Array, float] | Refused:
    """Mean, covariance and the innovation's normalised square; or why the measurement is not taken."""
    seen = linear(y)
    if seen is None:
        return Refused("cannot come from this target")
    h, H, extra = seen
    noise = cov + extra if extra else cov
    whitener = _whitener(noise)
    if whitener is None:
        return Refused("its covariance is not one")
    off, point, nis = z - h, y, 0.0
    for turn in range(RELINEARISED):
        PHt = P @ H.T
        T, a = _axes(whitener, H @ PHt)
        u = T @ off
        squares, spread = (u * u).tolist(), a.tolist()
        if turn == 0:
            nis = sum(square / (1 + variance) for square, variance in zip(squares, spread, strict=True))
            if not nis <= gate_threshold(len(squares), gate_sigmas):
                return Refused("disagrees", nis)
        s = _scale(squares, spread, nu)
        B, gain = PHt @ T.T, s / (1 + s * a)
        step = B @ (gain * u)
        seen = linear(y + step)
        if seen is None:
            return Refused("cannot come from this target")
        curved = T @ (seen[0] - h - H @ (step if turn == 0 else y + step - point))
        point = y + step
        if turn == RELINEARISED - 1 or float(curved @ curved) < SETTLED**2:
            break
        h, H, _ = seen
        off = z - h + H @ step
    return point, P - (B * gain) @ B.T, nis


def _axes(whitener: Array, predicted: Array) -> tuple[Array, Array]:
    """T (m, m) and a (m,): T noise T' = 1, T predicted T' = diag(a)."""
    if len(predicted) == 1:
        return whitener, predicted[0] * whitener[0, 0] ** 2
    a, U = np.linalg.eigh(whitener @ predicted @ whitener.T)
    return U.T @ whitener, np.maximum(a, 0.0)


def _whitener(C: Array) -> Array | None:
    """W (m, m), lower, with W C W' = 1; None where C is no covariance. Up to three by hand: that takes a third."""
    if len(C) > 3:
        try:
            return np.linalg.inv(np.linalg.cholesky(C))
        except np.linalg.LinAlgError:
            return None
    factor = cholesky(C.tolist())
    if factor is None:
        return None
    a, b, c, d, e, f = factor  # of the lower triangle, row by row
    if len(C) == 1:
        return np.array([[1 / a]])
    if len(C) == 2:
        return np.array([[1 / a, 0.0], [-b / (a * c), 1 / c]])
    return np.array(
        [[1 / a, 0.0, 0.0], [-b / (a * c), 1 / c, 0.0], [(b * e - c * d) / (a * c * f), -e / (c * f), 1 / f]]
    )


def _scale(squares: list[float], a: list[float], nu: float) -> float:
    """By how much the noise is narrower than stated (below 1: wider), given innovations squared along the axes."""
    s, m = 1.0, len(a)
    for _ in range(SCALE_STEPS):
        spread = 0.0
        for square, variance in zip(squares, a, strict=True):
            kept = 1 / (1 + s * variance)
            spread += kept * (kept * square + variance)
        before, s = s, (nu + m) / (nu + spread)
        if abs(s - before) < SCALE_SETTLED:
            break
    return s
