"""How the target moves between two measurements: the transition F and the noise Q of a step.

``velocity``: constant velocity driven by white acceleration. ``acceleration``: Singer's model, an acceleration that is
forgotten with a time constant (R. A. Singer 1970; X. R. Li, V. P. Jilkov 2003, "Survey of maneuvering target tracking,
part I", section IV; a long time constant is the white-jerk model). Both take the same power density of acceleration.

A camera that turns with w sees a target at p move by -w x p besides. Where w is measured, the velocity without that
part is what stays constant (in a frame that does not turn), so that turning to and fro costs nothing.
"""

from __future__ import annotations

from math import cos, exp, sin, sqrt

import numpy as np

from leadline.estimation.adapt import Noise
from leadline.estimation.settings import FilterSettings
from leadline.estimation.state import State
from leadline.samples import NS_PER_S, Array

COMMON_S = 10.0  # how long light and water let all edges of an outline err alike
CLOCK_WALK_S = 5e-4  # how far clocks drift apart, per square root of a second
SHORT = 0.02  # of the time constant: below, Singer's noise is taken from its first terms (the full ones cancel)


class MotionModel:
    """Steps of a state with k shape parameters; ``shape_walk`` (k,): their change, per square root of a second."""

    def __init__(self, settings: FilterSettings, shape_walk: Array) -> None:
        self._settings = settings
        self._derivatives = 2 if settings.model == "acceleration" else 1
        self.k = len(shape_walk)
        self.size = 3 + self.k + 3 * self._derivatives + 2
        self._eye = np.eye(self.size)
        walk = np.zeros(self.size)
        walk[3 : 3 + self.k] = shape_walk**2
        walk[-1] = CLOCK_WALK_S**2 if settings.laser_clock_sigma_s > 0 else 0.0
        self._walk = np.diag(walk)
        derivatives = range(self._derivatives + 1)
        self._diagonals = [[self._diagonal(row, column) for column in derivatives] for row in derivatives]

    def start(self, t_ns: int, x: Array, cov: Array) -> State:
        """x = (position, shape) with its covariance; velocity, acceleration and clock unknown but for their size."""
        settings, d = self._settings, 3 + self.k
        variance = np.full(self.size, settings.initial_speed_m_s**2)
        if self._derivatives == 2:
            variance[d + 3 : d + 6] = settings.acceleration_psd / (2 * settings.manoeuvre_s)  # once it is stationary
        variance[-2], variance[-1] = 1.0, settings.laser_clock_sigma_s**2
        y, P = np.zeros(self.size), np.diag(variance)
        y[:d], P[:d, :d] = x, cov
        return State(t_ns, y, P, self.k, Noise(settings.acceleration_psd))

    def predict(self, state: State, t_ns: int, turn_rad_s: Array | None = None, turn_sigma: float = 0.0) -> State:
        """The state at another time; ``turn_rad_s`` (3,): the camera's mean rotation until then, where measured."""
        before = state.turn_rad_s
        if t_ns == state.t_ns and (turn_rad_s is None or (before is not None and (turn_rad_s == before).all())):
            return State(t_ns, state.y, state.P, self.k, state.noise, turn_rad_s, state.refused)
        F, Q = self.step(state, t_ns, turn_rad_s, turn_sigma)
        P = F @ state.P @ F.T
        P = P + P.T  # rounding must not make it lopsided: that would grow
        P *= 0.5
        P += Q
        return State(t_ns, F @ state.y, P, self.k, state.noise, turn_rad_s, state.refused)

    def step(
        self, state: State, t_ns: int, turn_rad_s: Array | None = None, turn_sigma: float = 0.0
    ) -> tuple[Array, Array]:
        """F and Q (n, n) of ``predict``."""
        dt, psd = (t_ns - state.t_ns) / NS_PER_S, state.noise.acceleration_psd
        F, Q = self._eye.copy(), abs(dt) * self._walk
        F[-2, -2] = exp(-abs(dt) / COMMON_S)
        Q[-2, -2] = 1 - F[-2, -2] ** 2
        if self._derivatives == 1:
            self._block(F, 0, 1, dt)
            noise = white_acceleration(dt)
        else:
            forward, noise = singer(dt, self._settings.manoeuvre_s)
            for (row, column), value in forward.items():
                self._block(F, row, column, value)
        for (row, column), value in noise.items():
            self._block(Q, row, column, psd * value)
            if row != column:
                self._block(Q, column, row, psd * value)
        if turn_rad_s is not None:
            F = self._with_turn(F, state.turn_rad_s, turn_rad_s, dt)
            lever = cross(state.y[:3]) * (turn_sigma * dt)
            Q[:3, :3] += lever @ lever.T
        return F, Q

    def _start_of(self, derivative: int) -> int:
        return 0 if derivative == 0 else 3 * derivative + self.k

    def _block(self, M: Array, row: int, column: int, value: float) -> None:
        """Set the diagonal of the 3x3 block that couples two derivatives of the position."""
        M.reshape(-1)[self._diagonals[row][column]] = value

    def _diagonal(self, row: int, column: int) -> slice:
        first = self._start_of(row) * self.size + self._start_of(column)
        return slice(first, first + 2 * (self.size + 1) + 1, self.size + 1)

    def _with_turn(self, F: Array, before: Array | None, turn: Array, dt: float) -> Array:
        """The step in a frame that does not turn: the turn is taken out of the velocity, and put in again after it."""
        d = 3 + self.k
        out, turned, back = self._eye.copy(), self._eye.copy(), self._eye.copy()
        out[d : d + 3, :3] = cross(turn if before is None else before)
        back[d : d + 3, :3] = -cross(turn)
        R = rotation(-turn * dt)
        for derivative in range(self._derivatives + 1):
            at = self._start_of(derivative)
            turned[at : at + 3, at : at + 3] = R
        return np.asarray(back @ turned @ F @ out)


def white_acceleration(dt: float) -> dict[tuple[int, int], float]:
    """Noise of (position, velocity) after ``dt`` for unit power density: blocks (row, column)."""
    h = abs(dt)
    return {(0, 0): h**3 / 3, (0, 1): dt * h / 2, (1, 1): h}


def singer(dt: float, manoeuvre_s: float) -> tuple[dict[tuple[int, int], float], dict[tuple[int, int], float]]:
    """Blocks of F above the diagonal and on its end, and of Q, for unit power density of acceleration (2 sigma^2 T)."""
    T, h = manoeuvre_s, abs(dt)
    u = dt / T
    e = exp(-min(max(u, -50.0), 50.0))
    forward = {(0, 1): dt, (0, 2): T * T * (u - 1 + e), (1, 2): T * (1 - e), (2, 2): e}
    jerk = 1 / T**2
    if h < SHORT * T:
        powers = {
            (0, 0): h**5 / 20, (0, 1): h**4 / 8, (0, 2): h**3 / 6, (1, 1): h**3 / 3, (1, 2): h**2 / 2, (2, 2): h
        }  # fmt: skip
        return forward, {block: jerk * value for block, value in powers.items()}
    u = h / T
    e, ee = exp(-u), exp(-2 * u)
    noise = {
        (0, 0): T**5 / 2 * (1 - ee + 2 * u + 2 * u**3 / 3 - 2 * u**2 - 4 * u * e),
        (0, 1): T**4 / 2 * (ee + 1 - 2 * e + 2 * u * e - 2 * u + u**2),
        (0, 2): T**3 / 2 * (1 - ee - 2 * u * e),
        (1, 1): T**3 / 2 * (4 * e - 3 - ee + 2 * u),
        (1, 2): T**2 / 2 * (ee + 1 - 2 * e),
        (2, 2): T / 2 * (1 - ee),
    }
    return forward, {block: jerk * value for block, value in noise.items()}


def cross(v: Array) -> Array:
    """The matrix (3, 3) of v x ."""
    x, y, z = v.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def rotation(vector: Array) -> Array:
    """The rotation (3, 3) about a vector by its length (Rodrigues)."""
    x, y, z = vector.tolist()
    angle = sqrt(x * x + y * y + z * z)
    if angle < 1e-12:
        return np.eye(3)
    x, y, z, sine, cosine = x / angle, y / angle, z / angle, sin(angle), cos(angle)
    v = 1 - cosine
    return np.array(
        [
            [cosine + v * x * x, v * x * y - sine * z, v * x * z + sine * y],
            [v * x * y + sine * z, cosine + v * y * y, v * y * z - sine * x],
            [v * x * z - sine * y, v * y * z + sine * x, cosine + v * z * z],
        ]
    )
