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
    off, point, P_after, nis = z - h, y, P, 0.0
    for turn in range(RELINEARISED):
        PHt = P @ H.T
        axes = _axes(H @ PHt, noise)
        if axes is None:
            return Refused("its covariance is not one")
        T, a = axes
        u = T @ off
        if turn == 0:
            nis = float(u @ (u / (1 + a)))
            if not nis <= gate_threshold(len(u), gate_sigmas):
                return Refused("disagrees", nis)
        s = _scale((u * u).tolist(), a.tolist(), nu)
        B, gain = PHt @ T.T, s / (1 + s * a)
        moved = y + B @ (gain * u)
        P_after = P - (B * gain) @ B.T
        seen = linear(moved)
        if seen is None:
            return Refused("cannot come from this target")
        curved = seen[0] - h - H @ (moved - point)
        point = moved
        if np.abs(T @ curved).max() < SETTLED:
            break
        h, H, _ = seen
        off = z - h + H @ (point - y)
    return point, P_after, nis


def _axes(predicted: Array, noise: Array) -> tuple[Array, Array] | None:
    """T (m, m) and a (m,): T noise T' = 1, T predicted T' = diag(a). None where a covariance is none."""
    if len(noise) == 1:
        variance = float(noise[0, 0])
        return (np.array([[1 / sqrt(variance)]]), predicted[0] / variance) if variance > 0 else None
    try:
        W = np.linalg.inv(np.linalg.cholesky(noise))
        a, U = np.linalg.eigh(W @ predicted @ W.T)
    except np.linalg.LinAlgError:
        return None
    return U.T @ W, np.maximum(a, 0.0)


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
