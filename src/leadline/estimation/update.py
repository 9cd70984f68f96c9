"""One measurement update: behind a gate that reports what it turns away, robust, and iterated where h is curved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import inf, isnan, sqrt

import numpy as np

from leadline.estimation.student import settle
from leadline.samples import Array

RELINEARISED = 5  # at most
SETTLED = 0.02  # of the measurement's sigma: h is straight enough

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
        return Refused("is beside the target, or grazes it")
    h, H, extra = seen
    noise = cov + extra if extra else cov
    off, point, P_after, nis, gate = z - h, y, P, 0.0, gate_threshold(len(z), gate_sigmas)
    for turn in range(RELINEARISED):
        PHt = P @ H.T
        settled = settle(H @ PHt, noise, off, nu, gate if turn == 0 else inf)
        if isinstance(settled, float):
            return Refused("is not a number") if isnan(settled) else Refused("disagrees", settled)
        if turn == 0:
            nis = settled.nis
        P_after = P - PHt @ settled.inverse @ PHt.T
        step = PHt @ settled.w
        before, point = point, y + step
        seen = linear(point)
        if seen is None:
            return Refused("is beside the target, or grazes it")
        if seen[1] is H:  # the very same Jacobian: it is straight
            break
        curved = seen[0] - h - H @ (point - before)
        if (curved**2 < SETTLED**2 * np.diagonal(noise)).all():
            break
        h, H, _ = seen
        off = z - h + H @ step
    return point, P_after, nis
