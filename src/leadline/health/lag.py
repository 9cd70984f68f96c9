"""Arrival less stamp: does a sensor come late, and can its stamps be right at all?"""

from __future__ import annotations

from collections import deque
from itertools import pairwise
from statistics import median

from leadline.health.states import State, Verdict
from leadline.samples import NS_PER_S

LATE_S = 0.2  # more than usual
AHEAD_S = 0.02  # a stamp later than its own arrival by this is of a wrong clock
WILD_S = 1.0  # stamps that leap against the arrivals by this, again and again
DRIFT = 0.04  # s/s
LEARNT_AFTER = 8
KEPT = 12


class Lag:
    def __init__(self) -> None:
        self._all: deque[tuple[int, int]] = deque(maxlen=KEPT)  # arrival, stamp
        self._first: list[float] = []
        self._usual_s: float | None = None

    def add(self, now_ns: int, t_ns: int) -> None:
        self._all.append((now_ns, t_ns))
        lag_s = (now_ns - t_ns) / NS_PER_S
        if self._usual_s is None:
            self._first.append(lag_s)
            if len(self._first) == LEARNT_AFTER:
                self._usual_s = median(self._first)
        elif abs(lag_s - self._usual_s) < LATE_S / 4:
            self._usual_s += 0.01 * (lag_s - self._usual_s)

    @property
    def heard(self) -> bool:
        return bool(self._all)

    @property
    def excess_s(self) -> list[float]:
        """How much later than usual the last samples came, oldest first; empty while the usual is not known."""
        if self._usual_s is None:
            return []
        return [(now - t) / NS_PER_S - self._usual_s for now, t in self._all]

    def late(self) -> Verdict:
        last = self.excess_s[-3:]
        if len(last) == 3 and min(last) > LATE_S:
            return State.DELAYED, f"samples come {min(last):.1f} s later than usual"
        return None

    def impossible(self) -> Verdict:
        """What no delay explains: stamps that stand still, leap, run at another speed or lie in the future."""
        pairs = list(self._all)
        steps = [(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(pairs)]
        if len(steps) >= 2 and all(stamps == 0 for _, stamps in steps[-2:]):
            return State.STUCK, "the stamps stand still"
        leaps = [abs(stamps - arrivals) > WILD_S * NS_PER_S for arrivals, stamps in steps[-4:]]
        if sum(leaps) >= 3:
            return State.GARBAGE, "the stamps leap to and fro"
        if sum(leaps) == 2:
            return State.INTERMITTENT, "the stamps leap now and then"
        if any(stamps < -WILD_S * NS_PER_S for _, stamps in steps[-2:]):
            return State.WRONG, "the stamps went back"
        lags_s = [(now - t) / NS_PER_S for now, t in pairs[-2:]]
        usual_s = self._usual_s or 0.0
        if len(lags_s) == 2 and max(lags_s) < min(-AHEAD_S, usual_s - LATE_S):
            return State.WRONG, f"the stamps are {-max(lags_s):.2f} s in the future"
        return None

    def drifts(self) -> bool:
        """Whether the lag grew or shrank steadily over the last samples, far more than its jitter."""
        excess = self.excess_s
        if len(excess) < KEPT:
            return False
        span_s = (self._all[-1][0] - self._all[0][0]) / NS_PER_S
        steps = [b - a for a, b in pairwise(excess)]
        steady = min(sum(step > 0 for step in steps), sum(step < 0 for step in steps)) <= 1
        return steady and span_s > 0 and abs(excess[-1] - excess[0]) / span_s > DRIFT
