"""The filter: constant velocity, robust updates, late measurements replayed in order, recovery after a lost lock.

Both sensors feed one state; the stages of the paper are only which measurements there are. A hard gate alone is a trap
(it can lock the truth out for ever), so measurements that are turned away one after another but agree among themselves
make the filter start again from them.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leadline.estimation.update import State, seen, update
from leadline.samples import NS_PER_S, Array, Kind, Measurement, Rejected


@dataclass(frozen=True, slots=True)
class FilterSettings:
    """``config.FilterConfig`` documents these."""

    acceleration_psd: float = 0.01  # m^2/s^3
    initial_speed_m_s: float = 0.4
    gate_sigmas: float = 5.0
    student_nu: float = 4.0
    horizon_s: float = 2.0
    recover_after: int = 3


@dataclass(frozen=True, slots=True)
class Estimate:
    """Target vector x = (position, shape) with covariance, and velocity (3,), at ``t_ns``."""

    t_ns: int
    x: Array
    cov: Array
    velocity_m_s: Array


@dataclass(frozen=True, slots=True)
class _Entry:
    measurements: tuple[Measurement, ...]
    after: State


class Filter:
    """``start`` with a first idea of the target, then ``add`` measurements in any order within the horizon."""

    def __init__(self, settings: FilterSettings = FilterSettings()) -> None:
        self._settings = settings
        self._history: list[_Entry] = []
        self._turned_away: list[Measurement] = []
        self._shape_walk: Array = np.empty(0)

    @property
    def alive(self) -> bool:
        return bool(self._history)

    def stop(self) -> None:
        self._history.clear()
        self._turned_away.clear()

    def start(self, t_ns: int, x: Array, cov: Array, shape_walk: Array | None = None) -> None:
        """Begin at x = (position, shape) with its covariance; the velocity is unknown but for its usual size.

        shape_walk: (k,) how much the shape may change, per square root of a second (default: not at all).
        """
        if shape_walk is not None:
            self._shape_walk = shape_walk
        elif len(self._shape_walk) != len(x) - 3:
            self._shape_walk = np.zeros(len(x) - 3)
        y = np.concatenate([x[:3], np.zeros(3), x[3:]])
        P = np.zeros((len(y), len(y)))
        index = seen(len(y))
        P[np.ix_(index, index)] = cov
        P[3:6, 3:6] = self._settings.initial_speed_m_s**2 * np.eye(3)
        self._history = [_Entry((), State(t_ns, y, P))]
        self._turned_away.clear()

    def add(self, t_ns: int, measurements: Sequence[Measurement]) -> tuple[list[Kind], list[Rejected]]:
        """Take measurements of one instant; an earlier one is put in its place and the rest replayed."""
        at = bisect_right(self._history, t_ns, key=lambda entry: entry.after.t_ns)
        if at == 0:
            return [], [Rejected(m.kind, t_ns, "too late") for m in measurements]
        later = [(entry.after.t_ns, entry.measurements) for entry in self._history[at:]]
        del self._history[at:]
        used, rejected = self._apply(t_ns, measurements)
        for later_t_ns, later_measurements in later:
            self._apply(later_t_ns, later_measurements)
        self._forget()
        restarted = self._recover(measurements, used)
        if restarted is not None:
            return [restarted.kind], [r for r in rejected if r.kind is not restarted.kind]
        return used, rejected

    def at(self, t_ns: int) -> Estimate:
        """The state at a time: from all that was measured until then (and not after)."""
        at = max(bisect_right(self._history, t_ns, key=lambda entry: entry.after.t_ns), 1)
        state = self._predict(self._history[at - 1].after, t_ns)
        index = state.seen
        return Estimate(t_ns, state.y[index], state.P[np.ix_(index, index)], state.y[3:6])

    def _apply(self, t_ns: int, measurements: Sequence[Measurement]) -> tuple[list[Kind], list[Rejected]]:
        state = self._predict(self._history[-1].after, t_ns)
        used: list[Kind] = []
        rejected: list[Rejected] = []
        for measurement in measurements:
            result = update(state, measurement, self._settings.gate_sigmas, self._settings.student_nu)
            if isinstance(result, Rejected):
                rejected.append(result)
            else:
                state = result
                used.append(measurement.kind)
        self._history.append(_Entry(tuple(measurements), state))
        return used, rejected

    def _predict(self, state: State, t_ns: int) -> State:
        """Constant velocity with white acceleration; the shape walks, if at all."""
        dt = (t_ns - state.t_ns) / NS_PER_S
        F = np.eye(len(state.y))
        F[:3, 3:6] = dt * np.eye(3)
        q = self._settings.acceleration_psd * abs(dt)
        Q = np.zeros_like(F)
        Q[:3, :3] = q * dt**2 / 3 * np.eye(3)
        Q[:3, 3:6] = Q[3:6, :3] = q * dt / 2 * np.eye(3)
        Q[3:6, 3:6] = q * np.eye(3)
        Q[6:, 6:] = abs(dt) * np.diag(self._shape_walk**2)
        return State(t_ns, F @ state.y, F @ state.P @ F.T + Q)

    def _forget(self) -> None:
        """Keep the horizon, and one entry before it to replay from."""
        oldest = self._history[-1].after.t_ns - int(self._settings.horizon_s * NS_PER_S)
        keep_from = bisect_right(self._history, oldest, key=lambda entry: entry.after.t_ns)
        del self._history[: max(keep_from - 1, 0)]

    def _recover(self, measurements: Sequence[Measurement], used: Sequence[Kind]) -> Measurement | None:
        """Start again from a run of turned-away positions that agree among themselves, when no position was taken."""
        whole = [m for m in measurements if len(m.z) >= 3]  # those that fix the position by themselves
        if not whole:
            return None
        if any(m.kind in used for m in whole):
            self._turned_away.clear()
            return None
        newest = whole[0]
        if self._turned_away and not self._agree(self._turned_away[-1], newest):
            self._turned_away.clear()
        self._turned_away.append(newest)
        if len(self._turned_away) < self._settings.recover_after:
            return None
        self.start(newest.t_ns, newest.z, newest.cov)
        return newest

    def _agree(self, before: Measurement, after: Measurement) -> bool:
        dt = (after.t_ns - before.t_ns) / NS_PER_S
        moved = after.z[:3] - before.z[:3]
        spread = before.cov[:3, :3] + after.cov[:3, :3] + (self._settings.initial_speed_m_s * dt) ** 2 * np.eye(3)
        return bool(moved @ np.linalg.solve(spread, moved) < self._settings.gate_sigmas**2)
