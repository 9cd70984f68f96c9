"""The fixed-interval smoother: what was at each time, given all that was measured before and after.

H. E. Rauch, F. Tung, C. T. Striebel 1965, over the robust filter's own states: what it turned away or made little of
stays so. For recorded dives; a live one does not know what comes.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from leadline.estimation.models import MotionModel
from leadline.estimation.replay import Entry
from leadline.estimation.state import Estimate, State

NEW_CLOCK = 1.5  # a clock's variance that grows by so much in an update was set anew there


@dataclass(frozen=True, slots=True)
class Track:
    """The instants of one track, from its start to its end, in order."""

    model: MotionModel
    entries: Sequence[Entry]


class Smoothed:
    """All tracks of a dive, smoothed."""

    def __init__(self, tracks: Sequence[Track]) -> None:
        self._tracks = [track for track in tracks if track.entries]
        self._states = [_backwards(track) for track in self._tracks]

    def at(self, t_ns: int) -> Estimate | None:
        """The smoothed state at a time; None before the first track."""
        number = bisect_right([track.entries[0].t_ns for track in self._tracks], t_ns) - 1
        if number < 0:
            return None
        track, states = self._tracks[number], self._states[number]
        at = bisect_right(states, t_ns, key=lambda state: state.t_ns) - 1
        if states[at].t_ns == t_ns:
            return states[at].estimate()
        if at + 1 == len(states):
            return track.model.predict(states[at], t_ns).estimate()
        following = track.entries[at + 1]
        between = track.model.predict(track.entries[at].after, t_ns, following.before.turn_rad_s)
        return _step_back(track.model, between, following, states[at + 1]).estimate()


def _backwards(track: Track) -> list[State]:
    states = [track.entries[-1].after]
    for i in range(len(track.entries) - 2, -1, -1):
        states.append(_step_back(track.model, track.entries[i].after, track.entries[i + 1], states[-1]))
    return states[::-1]


def _step_back(model: MotionModel, state: State, following: Entry, smoothed: State) -> State:
    """The smoothed state before ``following``, whose smoothed state is known."""
    before = following.before
    F = model.step(state, before.t_ns, before.turn_rad_s)[0]
    tied = np.diag(before.P) > 0  # what is known for certain needs no correction
    tied[-1] &= following.after.P[-1, -1] <= NEW_CLOCK * before.P[-1, -1]
    predicted = before.P[np.ix_(tied, tied)]
    gain = np.linalg.solve(predicted, F[tied] @ state.P).T
    y = state.y + gain @ (smoothed.y - before.y)[tied]
    P = state.P + gain @ (smoothed.P[np.ix_(tied, tied)] - predicted) @ gain.T
    return replace(state, y=np.asarray(y), P=np.asarray((P + P.T) / 2))
