"""Parts that are given work: the detector, the disk, the outputs. Do they answer, in time, and rightly?"""

from __future__ import annotations

from collections import deque
from statistics import median

from leadline.health.states import State, Verdict
from leadline.samples import NS_PER_S

PENDING_S = 0.7  # unanswered for so long is stuck
SLOWER, SLOWER_S = 3.0, 0.05
LATE_S = 0.3
KEPT = 6
LEARNT_AFTER = 8


class Work:
    def __init__(self) -> None:
        self._asked_ns: int | None = None  # the oldest that is not answered
        self._took: deque[float] = deque(maxlen=5)
        self._lags: deque[float] = deque(maxlen=3)
        self._faults: deque[tuple[State, str] | None] = deque(maxlen=KEPT)
        self._first: list[float] = []
        self._usual_s: float | None = None

    def asked(self, now_ns: int) -> None:
        if self._asked_ns is None:
            self._asked_ns = now_ns

    def done(self, took_s: float, fault: Verdict, lag_s: float) -> None:
        """One answer. fault: what its caller saw of it; lag_s: how old the thing was that it answers."""
        self._asked_ns = None
        self._faults.append(fault)
        self._took.append(took_s)
        self._lags.append(lag_s)
        if self._usual_s is None:
            self._first.append(took_s)
            if len(self._first) == LEARNT_AFTER:
                self._usual_s = median(self._first)

    def verdict(self, now_ns: int) -> Verdict:
        waiting_s = 0.0 if self._asked_ns is None else (now_ns - self._asked_ns) / NS_PER_S
        if waiting_s > PENDING_S:
            return State.STUCK, f"no answer for {waiting_s:.1f} s"
        faults = list(self._faults)
        if len(faults) >= 2 and faults[-1] is not None and faults[-2] is not None:
            return faults[-1]
        bad = [i for i, fault in enumerate(faults) if fault is not None]
        if bad and None in faults[bad[0] : bad[-1]] and faults[-3:] != [None] * 3:  # was well, and is not again
            last = faults[bad[-1]]
            assert last is not None
            return State.INTERMITTENT, f"fails now and then: {last[1]}"
        if len(self._lags) == 3 and min(self._lags) > LATE_S:
            return State.DELAYED, f"answers come {min(self._lags):.1f} s late"
        return self._slow()

    def _slow(self) -> Verdict:
        if self._usual_s is None or len(self._took) < 3:
            return None
        recent_s = median(list(self._took)[-3:])
        if recent_s > max(SLOWER * self._usual_s, self._usual_s + SLOWER_S):
            return State.SLOW, f"takes {recent_s * 1e3:.0f} ms, usually {self._usual_s * 1e3:.0f} ms"
        return None
