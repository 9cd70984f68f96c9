"""The filter: robust updates, late measurements replayed in order, noise that adapts, recovery after a lost lock.

Both sensors feed one state; the stages of the paper are only which measurements there are. A hard gate alone is a trap
(it can lock the truth out for ever), so measurements that are turned away one after another but agree among themselves
make the filter start again from the first of them. docs/filter.md has the equations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from leadline.estimation.instant import take, take_motion
from leadline.estimation.models import MotionModel
from leadline.estimation.recovery import CONTRADICTED, livelier, without_readings, without_suspect
from leadline.estimation.replay import Entry, History, Inputs
from leadline.estimation.settings import FilterSettings
from leadline.estimation.smoother import Smoothed, Track
from leadline.estimation.state import Estimate, State
from leadline.estimation.turns import Turns
from leadline.samples import NS_PER_S, Array, Kind, Measurement, Rejected, VehicleMotion

MOST_TURNED_AWAY = 30


class Filter:
    """``start`` with a first idea of the target, then ``add`` measurements in any order within the horizon.

    keep: remember all of it, for ``smoothed``.
    """

    def __init__(self, settings: FilterSettings | None = None, *, keep: bool = False) -> None:
        self._settings = settings = settings or FilterSettings()
        self._model = MotionModel(settings, np.empty(0))
        self._shape_walk: Array = np.empty(0)
        self._history = History(settings.horizon_s, keep)
        self._tracks: list[Track] = []  # those that ended, where all is kept
        self._turns = Turns(settings.horizon_s)
        self._turned_away: list[Measurement] = []
        self._told: dict[int, Estimate] = {}  # since it last learned something

    @property
    def alive(self) -> bool:
        return bool(self._history.entries)

    def stop(self) -> None:
        if self._history.keep:
            self._tracks.append(Track(self._model, self._history.all()))
        self._told.clear()
        self._history = History(self._settings.horizon_s, self._history.keep)
        self._turned_away.clear()

    def start(self, t_ns: int, x: Array, cov: Array, shape_walk: Array | None = None) -> None:
        """Begin at x = (position, shape) with its covariance; the velocity is unknown but for its usual size.

        shape_walk: (k,) how much the shape may change, per square root of a second (default: not at all).
        """
        if shape_walk is not None:
            self._shape_walk = shape_walk
        elif len(self._shape_walk) != len(x) - 3:
            self._shape_walk = np.zeros(len(x) - 3)
        self.stop()
        self._model = MotionModel(self._settings, self._shape_walk)
        self._history.begin(self._model.start(t_ns, x, cov))

    def add(self, t_ns: int, measurements: Sequence[Measurement]) -> tuple[list[Kind], list[Rejected]]:
        """Take measurements of one instant; an earlier one is put in its place and the rest replayed."""
        self._told.clear()
        entry = self._history.insert(t_ns, tuple(measurements), self._apply)
        whole = [m for m in measurements if len(m.z) >= 3]  # those that fix the position by themselves
        recovered = bool(whole) and self._recover(entry, whole[0])
        if entry is not None and not whole and entry.after.refused >= CONTRADICTED:
            self._history.entries = without_readings(self._history, entry, self._apply) or self._history.entries
        if entry is None and not recovered:
            return [], [Rejected(m.kind, t_ns, "too late") for m in measurements]
        taken = self._history.last(t_ns).taken
        return list(taken.used), list(taken.rejected)

    def add_motion(self, motion: VehicleMotion) -> None:
        """How the vehicle moves: its rotation carries the predictions from now on, its velocity is a measurement."""
        self._told.clear()
        self._turns.add(motion)
        if motion.velocity_m_s is not None and self.alive:
            self._history.insert(motion.t_ns, motion, self._apply)

    def at(self, t_ns: int) -> Estimate:
        """The state at a time: from all that was measured until then (and not after)."""
        if t_ns not in self._told:
            self._told[t_ns] = self._predict(self._history.last(t_ns).after, t_ns).estimate()
        return self._told[t_ns]

    def smoothed(self) -> Smoothed:
        """What was at each time, given all that was measured; for a filter that keeps it."""
        return Smoothed([*self._tracks, Track(self._model, self._history.all())])

    def _predict(self, state: State, t_ns: int) -> State:
        return self._model.predict(state, t_ns, *self._turns.mean(state.t_ns, t_ns))

    def _apply(self, state: State, t_ns: int, inputs: Inputs) -> Entry:
        before = self._predict(state, t_ns)
        if isinstance(inputs, VehicleMotion):
            return Entry(inputs, before, take_motion(before, inputs, self._settings))
        return Entry(inputs, before, *take(before, inputs, self._settings))

    def _recover(self, entry: Entry | None, position: Measurement) -> bool:
        """Where a position was turned away: whether all is well again."""
        if entry is not None and entry.taken.position:
            self._turned_away.clear()
            return True
        agreed = self._agreeing(position)
        self._turned_away = [*self._turned_away[-MOST_TURNED_AWAY:], position]
        entries = None if entry is None else without_suspect(self._history, entry, self._apply)
        if entries is None and entry is not None and len(agreed) > 1 and self._settings.adapt:
            entries = livelier(self._history, agreed, self._apply, self._settings.acceleration_psd)
        if entries is not None:
            self._history.entries = entries
            self._turned_away.clear()
            return True
        lasted_s = (position.t_ns - agreed[0].t_ns) / NS_PER_S
        if len(agreed) < self._settings.recover_after or lasted_s < self._settings.recover_after_s:
            return False
        self._start_again(agreed)
        return True

    def _agreeing(self, newest: Measurement) -> list[Measurement]:
        """The positions turned away that lead to the newest one, from each to the next; it is the last of them."""
        chain = [newest]
        for m in reversed(self._turned_away):
            if self._agree(m, chain[-1]):
                chain.append(m)
        return chain[::-1]

    def _agree(self, before: Measurement, after: Measurement) -> bool:
        dt = (after.t_ns - before.t_ns) / NS_PER_S
        moved = after.z[:3] - before.z[:3]
        spread = before.cov[:3, :3] + after.cov[:3, :3] + (self._settings.initial_speed_m_s * dt) ** 2 * np.eye(3)
        return bool(moved @ np.linalg.solve(spread, moved) < self._settings.gate_sigmas**2)

    def _start_again(self, positions: Sequence[Measurement]) -> None:
        """From the first of the positions that were turned away, with all that was measured since."""
        first, *others = positions
        since: list[tuple[int, Inputs]] = [(e.t_ns, e.inputs) for e in self._history.since(first.t_ns)]
        if first.t_ns < self._history.entries[0].t_ns:  # they were too late, as the clock was set back
            since = [(m.t_ns, (m,)) for m in others]
        before = self._history.entries[-1].after
        self._history.end(first.t_ns)
        self.start(first.t_ns, first.z, first.cov)
        begin = self._history.entries[0].after
        if len(begin.y) == len(before.y):
            for i in (-2, -1):  # the outline's error and the clock go on as they did
                begin.y[i], begin.P[i, i] = before.y[i], before.P[i, i]
        self._history.begin(replace(begin, noise=before.noise))
        for t_ns, inputs in since:
            self._history.insert(t_ns, inputs, self._apply)
