"""One robust measurement update: iterated, with Student-t noise, behind a gate that reports what it turns away.

State y = (position (3,), velocity (3,), shape (k,)); a measurement sees x = (position, shape).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leadline.samples import Array, Measurement, Rejected

ITERATIONS = 5  # of relinearisation and of the noise's scale together; they settle in two or three


@dataclass(frozen=True, slots=True)
class State:
    """Mean (6 + k,) and covariance at ``t_ns``."""

    t_ns: int
    y: Array
    P: Array

    @property
    def seen(self) -> NDArray[np.int_]:
        """Indices of what measurements see: position and shape."""
        return seen(len(self.y))


def seen(size: int) -> NDArray[np.int_]:
    return np.concatenate([np.arange(3), np.arange(6, size)])


def gate_threshold(dof: int, sigmas: float) -> float:
    """Chi-square value whose tail equals that of ``sigmas`` of a normal (Wilson and Hilferty 1931)."""
    spread = 2 / (9 * dof)
    return float(dof * (1 - spread + sigmas * np.sqrt(spread)) ** 3)


def update(state: State, measurement: Measurement, gate_sigmas: float, nu: float) -> State | Rejected:
    """Take one measurement, or say why not.

    The noise is Student-t with ``nu`` degrees of freedom: its scale is settled together with the state by fixed-point
    iteration (Agamennoni, Nieto, Nebot 2012, "Approximate inference in state-space models with heavy-tailed noise").
    """
    first = _linear(state.y, measurement)
    if first is None:
        return Rejected(measurement.kind, measurement.t_ns, "cannot come from this target")
    h, H = first
    innovation = measurement.z - h
    nis = float(innovation @ np.linalg.solve(H @ state.P @ H.T + measurement.cov, innovation))
    if not nis <= gate_threshold(len(h), gate_sigmas):
        return Rejected(measurement.kind, measurement.t_ns, "disagrees", nis)
    y, P, scale = state.y, state.P, 1.0
    for _ in range(ITERATIONS):
        linear = _linear(y, measurement)
        if linear is None:
            return Rejected(measurement.kind, measurement.t_ns, "cannot come from this target")
        h, H = linear
        noise = measurement.cov / scale
        S = H @ state.P @ H.T + noise
        gain = np.linalg.solve(S, H @ state.P).T
        y = state.y + gain @ (measurement.z - h - H @ (state.y - y))
        keep = np.eye(len(y)) - gain @ H
        P = keep @ state.P @ keep.T + gain @ noise @ gain.T  # Joseph's form stays positive
        linear = _linear(y, measurement)
        if linear is None:
            return Rejected(measurement.kind, measurement.t_ns, "cannot come from this target")
        residual = measurement.z - linear[0]
        spread = np.linalg.solve(measurement.cov, np.outer(residual, residual) + H @ P @ H.T)
        scale = (nu + len(h)) / (nu + float(np.trace(spread)))
    return State(state.t_ns, y, (P + P.T) / 2)


def _linear(y: Array, measurement: Measurement) -> tuple[Array, Array] | None:
    """h(x) and its Jacobian over the whole state, or None where the measurement is impossible from there."""
    index = seen(len(y))
    predicted = measurement.predict(y[index])
    if predicted is None:
        return None
    h, H_x = predicted
    H = np.zeros((len(h), len(y)))
    H[:, index] = H_x
    return h, H
