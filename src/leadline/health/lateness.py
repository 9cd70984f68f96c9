"""Does a detector answer of the picture it was given, or of an older one? Told by where the target was expected."""

from __future__ import annotations

from collections import deque

import numpy as np

from leadline.health.states import State, Verdict
from leadline.samples import NS_PER_S, Array

LATE_S, LONGEST_S = 0.3, 1.5
COMPARED = 7  # boxes
SIGMA_PX, SIGMA_SIZE = 0.5, 0.02  # of a box's middle: at least, and of its size
EVIDENCE = 14.0  # log likelihood ratio: older against now


class Lateness:
    """A box's middle, less its usual distance from where it is expected, against the places expected lately."""

    def __init__(self) -> None:
        self._expected: deque[tuple[int, Array]] = deque()
        self._seen: deque[tuple[int, Array]] = deque(maxlen=COMPARED)
        self._bias_px: Array | None = None

    def judge(self, t_ns: int, middle_px: Array, size_px: float, expected_px: Array) -> Verdict:
        """middle_px, expected_px (2,)."""
        self._expected.append((t_ns, expected_px))
        while t_ns - self._expected[0][0] > (LONGEST_S + 2.0) * NS_PER_S:
            self._expected.popleft()
        self._seen.append((t_ns, middle_px))
        off_px = middle_px - expected_px
        if self._bias_px is None:
            self._bias_px = off_px
        late_s = self._late_s(size_px)
        if late_s is not None:
            return State.DELAYED, f"answers of the picture {late_s:.1f} s before"
        self._bias_px = self._bias_px + 0.02 * (off_px - self._bias_px)
        return None

    def _late_s(self, size_px: float) -> float | None:
        if len(self._seen) < COMPARED:
            return None
        times = np.array([t for t, _ in self._seen], dtype=np.float64)
        seen = np.array([px for _, px in self._seen]) - self._bias_px
        then = np.array([t for t, _ in self._expected], dtype=np.float64)
        places = np.array([px for _, px in self._expected])
        lags_s = np.arange(0.0, LONGEST_S, 0.1)
        lags_s = lags_s[times[0] - lags_s * NS_PER_S >= then[0]]
        if len(lags_s) < 2:
            return None
        sigma_px = float(np.hypot(SIGMA_PX, SIGMA_SIZE * size_px))
        costs = np.array([self._cost(times - lag * NS_PER_S, seen, then, places) for lag in lags_s])
        best = int(np.argmin(costs))
        enough = (costs[0] - costs[best]) / (2 * sigma_px**2) > EVIDENCE
        return float(lags_s[best]) if enough and lags_s[best] >= LATE_S else None

    @staticmethod
    def _cost(times: Array, seen: Array, then: Array, places: Array) -> float:
        """Squared distances of what is seen from what was expected at these times, px^2."""
        expected = np.column_stack([np.interp(times, then, places[:, axis]) for axis in (0, 1)])
        return float(((seen - expected) ** 2).sum())
