"""How wide the noise of one measurement was, if noise is Student-t: the robust part of an update.

The scale s (below 1: wider than stated) is settled by the fixed point of Agamennoni, Nieto and Nebot 2012
("Approximate inference in state-space models with heavy-tailed noise"): s = (nu + m) / (nu + r' R^-1 r + tr(R^-1 A+)),
with what remains after the update, r = R w / s and A+ = R / s - R S^-1 R / s^2, where S = A + R / s and w = S^-1 off.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import nan

import numpy as np

from leadline.estimation.small import dot, filled, inverse, times, trace
from leadline.samples import Array

STEPS, SETTLED = 20, 0.01


@dataclass(frozen=True, slots=True)
class Settled:
    """The innovation's normalised square with the noise as stated; S^-1 (m, m) and w (m,) with the scale."""

    nis: float
    inverse: Array
    w: Array


def settle(predicted: Array, noise: Array, off: Array, nu: float, gate: float) -> Settled | float:
    """A (m, m) predicted, R (m, m) noise, innovation (m,). Just the NIS where beyond the gate, NaN without numbers."""
    return _by_hand(predicted, noise, off, nu, gate) if len(off) <= 3 else _at_large(predicted, noise, off, nu, gate)


def _by_hand(predicted: Array, noise: Array, off: Array, nu: float, gate: float) -> Settled | float:
    m, s = len(off), 1.0
    A, R = filled(predicted, 0.0), filled(noise, 1.0)
    a0, a1, a2, a3, a4, a5 = A
    r0, r1, r2, r3, r4, r5 = R
    x, y, z = (*off.tolist(), 0.0, 0.0)[:3]
    v, nis = (x, y, z), 0.0
    for step in range(STEPS):
        S = inverse((a0 + r0 / s, a1 + r1 / s, a2 + r2 / s, a3 + r3 / s, a4 + r4 / s, a5 + r5 / s))
        if S is None:
            return nan
        w = times(S, v)
        if step == 0:
            nis = dot(v, w)
            if not nis <= gate:
                return nis
        spread = 3 / s + (dot(w, times(R, w)) - trace(S, R)) / (s * s)
        before, s = s, (nu + m) / (nu + spread)
        if abs(s - before) < SETTLED * s:
            break
    assert S is not None
    full = np.array(((S[0], S[1], S[3]), (S[1], S[2], S[4]), (S[3], S[4], S[5])))
    return Settled(nis, full[:m, :m], np.array(w[:m]))


def _at_large(predicted: Array, noise: Array, off: Array, nu: float, gate: float) -> Settled | float:
    m, s, nis = len(off), 1.0, 0.0
    for step in range(STEPS):
        try:
            S = np.linalg.inv(predicted + noise / s)
        except np.linalg.LinAlgError:
            return nan
        w = S @ off
        if step == 0:
            nis = float(off @ w)
            if not nis <= gate:
                return nis
        spread = m / s + (float(w @ noise @ w) - float(np.sum(S * noise))) / s**2
        before, s = s, (nu + m) / (nu + spread)
        if abs(s - before) < SETTLED * s:
            break
    return Settled(nis, np.asarray(S), np.asarray(w))
