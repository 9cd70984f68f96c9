"""The filter: robust updates, late measurements replayed in order, noise that adapts, recovery after a lost lock.

Both sensors feed one state; the stages of the paper are only which measurements there are. A hard gate alone is a trap
(it can lock the truth out for ever), so measurements that are turned away one after another but agree among themselves
make the filter start again from the first of them. docs/filter.md has the equations.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from leadline.estimation.instant import take, take_motion
from leadline.estimation.models import MotionModel
from leadline.estimation.replay import Entry, History, Inputs
from leadline.estimation.settings import FilterSettings
from leadline.estimation.state import Estimate, State
from leadline.estimation.turns import Turns
from leadline.samples import NS_PER_S, Array, Kind, Measurement, Rejected, VehicleMotion


class Filter:
    """``start`` with a first idea of the target, then ``add`` measurements in any order within the horizon."""

    def __init__(self, settings: FilterSettings | None = None) -> None:
        self._settings = settings = settings or FilterSettings()
        self._model = MotionModel(settings, np.empty(0))
        self._shape_walk: Array = np.empty(0)
        self._history = History(settings.horizon_s)
        self._turns = Turns(settings.horizon_s)
        self._turned_away: list[Measurement] = []

    @property
    def alive(self) -> bool:
        return bool(self._history.entries)

    def stop(self) -> None:
        self._history.entries.clear()
        self._turned_away.clear()

    def start(self, t_ns: int, x: Array, cov: Array, shape_walk: Array | None = None) -> None:
        """Begin at x = (position, shape) with its covariance; the velocity is unknown but for its usual size.

        shape_walk: (k,) how much the shape may change, per square root of a second (default: not at all).
        """
        if shape_walk is not None:
            self._shape_walk = shape_walk
        elif len(self._shape_walk) != len(x) - 3:
            self._shape_walk = np.zeros(len(x) - 3)
        self._model = MotionModel(self._settings, self._shape_walk)
        self._history.begin(self._model.start(t_ns, x, cov))
        self._turned_away.clear()

    def add(self, t_ns: int, measurements: Sequence[Measurement]) -> tuple[list[Kind], list[Rejected]]:
        """Take measurements of one instant; an earlier one is put in its place and the rest replayed."""
        entry = self._history.insert(t_ns, tuple(measurements), self._apply)
        if self._lost_lock(measurements, () if entry is None else entry.used):
            entry = self._start_again() or entry
        if entry is None:
            return [], [Rejected(m.kind, t_ns, "too late") for m in measurements]
        return list(entry.used), list(entry.rejected)

    def add_motion(self, motion: VehicleMotion) -> None:
        """How the vehicle moves: its rotation carries the predictions from now on, its velocity is a measurement."""
        self._turns.add(motion)
        if motion.velocity_m_s is not None and self.alive:
            self._history.insert(motion.t_ns, motion, self._apply)

    def at(self, t_ns: int) -> Estimate:
        """The state at a time: from all that was measured until then (and not after)."""
        entries = self._history.entries
        return self._predict(entries[max(self._history.place(t_ns), 1) - 1].after, t_ns).estimate()

    def _predict(self, state: State, t_ns: int) -> State:
        return self._model.predict(state, t_ns, *self._turns.mean(state.t_ns, t_ns))

    def _apply(self, state: State, t_ns: int, inputs: Inputs) -> Entry:
        before = self._predict(state, t_ns)
        if isinstance(inputs, VehicleMotion):
            return Entry(inputs, before, take_motion(before, inputs, self._settings))
        after, used, rejected = take(before, inputs, self._settings)
        return Entry(inputs, before, after, tuple(used), tuple(rejected))

    def _lost_lock(self, measurements: Sequence[Measurement], used: Sequence[Kind]) -> bool:
        """Whether positions were turned away for long enough, agree among themselves, and none was taken meanwhile."""
        whole = [m for m in measurements if len(m.z) >= 3]  # those that fix the position by themselves
        if not whole:
            return False
        if any(m.kind in used for m in whole):
            self._turned_away.clear()
            return False
        if self._turned_away and not self._agree(self._turned_away[-1], whole[0]):
            self._turned_away.clear()
        self._turned_away.append(whole[0])
        lasted_s = (whole[0].t_ns - self._turned_away[0].t_ns) / NS_PER_S
        return len(self._turned_away) >= self._settings.recover_after and lasted_s >= self._settings.recover_after_s

    def _agree(self, before: Measurement, after: Measurement) -> bool:
        dt = (after.t_ns - before.t_ns) / NS_PER_S
        moved = after.z[:3] - before.z[:3]
        spread = before.cov[:3, :3] + after.cov[:3, :3] + (self._settings.initial_speed_m_s * dt) ** 2 * np.eye(3)
        return bool(moved @ np.linalg.solve(spread, moved) < self._settings.gate_sigmas**2)

    def _start_again(self) -> Entry | None:
        """From the first of the positions that were turned away, with all that was measured since; the newest entry."""
        first, *others = self._turned_away
        since: list[tuple[int, Inputs]] = [(e.t_ns, e.inputs) for e in self._history.since(first.t_ns)]
        if first.t_ns < self._history.entries[0].t_ns:  # they were too late, as the clock was set back
            since = [(m.t_ns, (m,)) for m in others]
        self.start(first.t_ns, first.z, first.cov)
        entry = None
        for t_ns, inputs in since:
            entry = self._history.insert(t_ns, inputs, self._apply)
        return entry
