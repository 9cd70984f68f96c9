"""What is measured at one instant, taken one after another into the state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import isfinite

import numpy as np

from leadline.estimation.models import cross
from leadline.estimation.replay import Taken
from leadline.estimation.settings import FilterSettings
from leadline.estimation.state import State
from leadline.estimation.update import Linear, Refused, gate_threshold, update
from leadline.samples import Array, Kind, Measurement, Rejected, VehicleMotion

UNMEASURED_TURN_RAD_S = 0.05  # how much a vehicle may turn while its velocity is measured and its rotation is not


def take(state: State, measurements: Sequence[Measurement], settings: FilterSettings) -> tuple[State, Taken]:
    """The state after an instant's measurements, one after another, and what became of them."""
    used: list[Kind] = []
    rejected: list[Rejected] = []
    position, surprise, predicted = False, 0.0, state
    for m in measurements:
        state, result = _take(state, m, settings)
        if isinstance(result, Refused):
            rejected.append(Rejected(m.kind, m.t_ns, result.reason, result.nis))
            continue
        used.append(m.kind)
        position |= len(m.z) >= 3
        surprise = max(surprise, result / gate_threshold(len(m.z), settings.gate_sigmas))
    if settings.adapt and position:
        moved = state.y[:3] - predicted.y[:3]
        noise = state.noise.after_correction(moved, predicted.P[:3, :3], state.P[:3, :3], settings.acceleration_psd)
        state = State(state.t_ns, state.y, state.P, state.k, noise, state.turn_rad_s, state.refused)
    return state, Taken(tuple(used), tuple(rejected), position, surprise)


def _take(state: State, m: Measurement, settings: FilterSettings) -> tuple[State, float | Refused]:
    """The state after it with the innovation's normalised square, or the state as it was with why."""
    scale = state.noise.scale(m.kind)
    cov = m.cov if m.common is None else m.cov - m.common[:, None] * m.common
    if scale != 1.0:
        cov = cov * scale
    linear = _reading(state, m) if m.kind is Kind.LASER else _plain(state, m)
    result = update(state.y, state.P, m.z, cov, linear, settings.gate_sigmas, settings.student_nu)
    refusals = state.refused
    if m.kind is Kind.LASER:
        refusals = state.refused + 1 if isinstance(result, Refused) else 0
        if refusals >= settings.recover_after and settings.laser_clock_sigma_s > 0:
            return _with_a_new_clock(state, m, cov, settings)
    nis = result.nis if isinstance(result, Refused) else result[2]
    noise = state.noise
    if settings.adapt and nis is not None and isfinite(nis):
        noise = noise.after_innovation(m.kind, nis, len(m.z))
    if isinstance(result, Refused):
        return replace(state, noise=noise, refused=refusals), result
    return State(state.t_ns, result[0], result[1], state.k, noise, state.turn_rad_s, refusals), result[2]


def _with_a_new_clock(
    state: State, m: Measurement, cov: Array, settings: FilterSettings
) -> tuple[State, float | Refused]:
    """Readings that are turned away one after another: perhaps the laser's clock was set. Is it that?"""
    P = state.P.copy()
    P[-1, :] = P[:, -1] = 0.0
    P[-1, -1] = settings.laser_clock_sigma_s**2
    y = state.y.copy()
    y[-1] = 0.0
    result = update(y, P, m.z, cov, _reading(replace(state, P=P), m), settings.gate_sigmas, settings.student_nu)
    if isinstance(result, Refused):
        return replace(state, refused=state.refused + 1), result
    return replace(state, y=result[0], P=result[1], refused=0), result[2]


def take_motion(state: State, motion: VehicleMotion, settings: FilterSettings) -> State:
    """The vehicle's velocity: what stands still moves by -velocity - rotation x p."""
    if motion.velocity_m_s is None:
        return state
    d, n, turn = 3 + state.k, len(state.y), state.turn_rad_s
    H = np.zeros((3, n))
    H[:, d : d + 3] = np.eye(3)
    if turn is not None:
        H[:, :3] = cross(turn)
    turn_sigma = UNMEASURED_TURN_RAD_S if turn is None else motion.rotation_sigma_rad_s
    lever = cross(state.y[:3]) * turn_sigma
    cov = motion.velocity_sigma_m_s**2 * np.eye(3) + lever @ lever.T
    z = -np.array(motion.velocity_m_s)
    result = update(state.y, state.P, z, cov, lambda y: (H @ y, H, 0.0), settings.gate_sigmas, settings.student_nu)
    return state if isinstance(result, Refused) else replace(state, y=result[0], P=result[1])


def _plain(state: State, m: Measurement) -> Linear:
    d, n = 3 + state.k, len(state.y)
    H = before = np.empty(0)

    def linear(y: Array) -> tuple[Array, Array, float] | None:
        nonlocal H, before
        seen = m.predict(y[:d])
        if seen is None:
            return None
        if seen[1] is not before:  # what is straight may give the same Jacobian each time
            before, H = seen[1], np.zeros((len(seen[0]), n))
            H[:, :d] = before
            if m.common is not None:
                H[:, -2] = m.common
        return seen[0] if m.common is None else seen[0] + y[-2] * m.common, H, 0.0

    return linear


def _reading(state: State, m: Measurement) -> Linear:
    """A reading was taken tau after its stamp, when the target was v tau farther on.

    Both are uncertain, and the variance of their product is noise besides (second-order filter: Jazwinski 1970, 9.3).
    The product is taken straight about the prediction: else one wrong reading finds a clock and a speed to suit it.
    """
    d, n, P = 3 + state.k, len(state.y), state.P
    velocity, tau = state.y[d : d + 3], float(state.y[-1])
    product = P[d : d + 3, d : d + 3] * P[-1, -1] + np.outer(P[d : d + 3, -1], P[d : d + 3, -1])

    def linear(y: Array) -> tuple[Array, Array, float] | None:
        x = y[:d].copy()
        x[:3] += tau * y[d : d + 3] + (y[-1] - tau) * velocity
        seen = m.predict(x)
        if seen is None:
            return None
        h, H_x = seen
        slope = H_x[0, :3]
        H = np.zeros((1, n))
        H[:, :d] = H_x
        H[0, d : d + 3] = tau * slope
        H[0, -1] = slope @ velocity
        return h, H, float(slope @ product @ slope)

    return linear
