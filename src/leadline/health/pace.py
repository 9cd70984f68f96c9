"""Does a sensor come at its rate? Off, slow, intermittent.

Each turn of its period is a hit or a miss. Two tests for a rate of misses above p0, the sensor's own, learnt while it
was well. A cumulative sum (Page 1954): misses speak for a fault by log(0.5 / p0), hits against it by
log((1 - p0) / 0.5), at worst false once in about e^LIMIT samples. And a scan (Naus 1965): k misses among the last 7
turns, k the least that chance brings about less than FALSE_PER_H times an hour. At 3 Hz with 1.6 % of the readings lost
k is 3, with 2 % 4: no test of 7 turns can promise one false flag an hour then and tell a loss of half of them by 3.
"""

from __future__ import annotations

from collections import deque
from math import comb, log
from statistics import median

from leadline.health.states import State, Verdict
from leadline.samples import NS_PER_S

LIMIT = 9.0
SCANNED = 7  # turns: within so many a fault is due
FALSE_PER_H = 0.7
LEARNT_AFTER = 6  # intervals
FIRST_S = 3.0  # a part that has never come within this time is off
LEAST_GAP_S = 0.5  # shorter silences are no silence
GAP_PERIODS = 3.5
PRIOR_MISSES, PRIOR_TURNS = 2.0, 100.0
WELL_AGAIN = 2  # hits in a row
LEAST_MISSES = 1e-3


class Pace:
    """period_s: where it is known; else it is learnt from the first samples."""

    def __init__(self, period_s: float | None = None) -> None:
        self._start_ns: int | None = None  # since when it is waited for
        self.period_s = period_s
        self._last: tuple[int, int] | None = None  # arrival, stamp
        self._intervals: deque[float] = deque(maxlen=LEARNT_AFTER)
        self._misses, self._turns = PRIOR_MISSES, PRIOR_TURNS
        self._sum = 0.0
        self._hits = WELL_AGAIN
        self._turned: deque[bool] = deque(maxlen=SCANNED)  # whether each of the last turns was a miss
        self._late = False

    def arrive(self, now_ns: int, t_ns: int) -> None:
        """A sample stamped ``t_ns`` is here; both times by the clock of the computer."""
        last, self._last = self._last, (now_ns, t_ns)
        if last is None:
            return
        interval_s = _interval_s(now_ns - last[0], t_ns - last[1])
        self._intervals.append(interval_s)
        if self.period_s is None:
            if len(self._intervals) == LEARNT_AFTER:
                self.period_s = max(median(self._intervals), 1e-4)
            return
        self._count(interval_s)

    def verdict(self, now_ns: int) -> Verdict:
        if self._last is None:
            self._start_ns = now_ns if self._start_ns is None else self._start_ns
            silent_s = (now_ns - self._start_ns) / NS_PER_S
            return (State.OFF, f"nothing has come for {silent_s:.0f} s") if silent_s > FIRST_S else None
        silent_s = (now_ns - self._last[0]) / NS_PER_S
        period_s = self.period_s or FIRST_S / GAP_PERIODS
        if silent_s > max(LEAST_GAP_S, GAP_PERIODS * period_s):
            self._late, self._hits = True, 0
            return State.OFF, f"nothing for {silent_s:.1f} s, usually every {period_s:.2f} s"
        if not self._late:
            return None
        return self._how(period_s)

    def _count(self, interval_s: float) -> None:
        assert self.period_s is not None
        misses = min(round(interval_s / self.period_s) - 1, 20)
        if misses <= 0:
            self._hits += 1
            self.period_s += 0.02 * (min(max(interval_s, 0.8 * self.period_s), 1.2 * self.period_s) - self.period_s)
        else:
            self._hits = 0
        p0 = min(max(self._misses / self._turns, LEAST_MISSES), 0.3)
        self._sum = max(0.0, self._sum + max(misses, 0) * log(0.5 / p0) - log((1 - p0) / 0.5))
        self._turned.extend([True] * max(misses, 0) + [False])
        if self._sum >= LIMIT or sum(self._turned) >= _too_many(p0, self.period_s):
            self._late = True
        if self._late and self._hits >= WELL_AGAIN:
            self._late, self._sum = False, 0.0
            self._turned.clear()
        if not self._late:
            self._misses, self._turns = (
                self._misses * 0.9995 + max(misses, 0),
                self._turns * 0.9995 + 1 + max(misses, 0),
            )

    def _how(self, period_s: float) -> tuple[State, str]:
        recent = list(self._intervals)[-3:]
        if len(recent) >= 2 and min(recent[-2:]) > 1.6 * period_s and max(recent[-2:]) < 1.3 * min(recent[-2:]):
            return State.SLOW, f"every {recent[-1]:.2f} s, usually every {period_s:.2f} s"
        return State.INTERMITTENT, f"samples are missing, usually every {period_s:.2f} s"


def _too_many(p0: float, period_s: float) -> int:
    """The least number of misses among the last turns that chance hardly ever brings about."""
    turns_per_h, others = 3600 / period_s, SCANNED - 1
    chance, k = p0, 1  # of a miss, and of k - 1 more among the turns before it
    while turns_per_h * chance > FALSE_PER_H and k < SCANNED:
        k += 1
        chance = p0 * sum(comb(others, j) * p0**j * (1 - p0) ** (others - j) for j in range(k - 1, SCANNED))
    return k


def _interval_s(arrivals_ns: int, stamps_ns: int) -> float:
    """Between two samples: by their stamps, which have no jitter, unless these make no sense."""
    sane = stamps_ns > 0 and abs(stamps_ns - arrivals_ns) < NS_PER_S // 2
    return (stamps_ns if sane else arrivals_ns) / NS_PER_S
