"""Is there anything in what comes? Pictures that are black, frozen or noise; ranges that stand still or leap."""

from __future__ import annotations

from collections import deque
from math import ceil, log
from statistics import median

import numpy as np

from leadline.health.states import State, Verdict
from leadline.samples import NS_PER_S, Image, LaserRange

STEP = 8  # every eighth pixel is looked at
BLACK, FLAT, NOISE = 6.0, 0.8, 32.0  # grey levels: mean; standard deviation; difference between neighbours
SAME_PICTURES = 2  # repeats in a row
BAD_PICTURES = 2
SAME_RANGES = 6
RANGES = 6
RANGE_SPREAD_M, RANGE_SPEED_M_S = 0.3, 0.5
FALSE_ALARM = 1e-7  # a run of equal readings that had this chance is a stuck device


class Pictures:
    """One camera's."""

    def __init__(self) -> None:
        self._last: bytes | None = None
        self._repeats = 0
        self._bad = 0
        self._seen: Verdict = None
        self.print: bytes = b""

    def look(self, image: Image) -> None:
        """image: (H, W[, 3]) uint8."""
        few = np.ascontiguousarray(image[STEP // 2 :: STEP, STEP // 2 :: STEP])
        self.print = few.tobytes()
        self._repeats = self._repeats + 1 if self.print == self._last else 0
        self._last = self.print
        seen = _emptiness(image, few)
        self._bad = self._bad + 1 if seen is not None else 0
        self._seen = seen

    def verdict(self) -> Verdict:
        if self._bad >= BAD_PICTURES:
            return self._seen
        if self._repeats >= SAME_PICTURES:
            return State.STUCK, f"the same picture {self._repeats + 1} times"
        return None


def _emptiness(image: Image, few: Image) -> Verdict:
    level, spread = float(few.mean()), float(few.std())
    if level < BLACK and spread < BLACK:
        return State.OFF, "the picture is black"
    if spread < FLAT:
        return State.OFF, "the picture is of one colour"
    rows = image[STEP // 2 :: 4 * STEP].astype(np.int16)
    if float(np.abs(np.diff(rows, axis=1)).mean()) > NOISE:
        return State.GARBAGE, "the picture is noise"
    return None


class Ranges:
    """The laser's readings by themselves."""

    def __init__(self) -> None:
        self._last: deque[tuple[int, float]] = deque(maxlen=RANGES)
        self._repeats = 0
        self._same, self._all = 5.0, 50.0  # how often a reading equals the one before, as learnt; a prior of 0.1
        self._refused: deque[bool] = deque(maxlen=5)
        self._words = ""

    def read(self, reading: LaserRange) -> None:
        if self._last:
            same = reading.range_m == self._last[-1][1]
            self._repeats = self._repeats + 1 if same else 0
            if self._repeats < SAME_RANGES:
                self._same, self._all = self._same * 0.999 + same, self._all * 0.999 + 1
        self._last.append((reading.t_ns, reading.range_m))
        self._refused.append(False)

    def refuse(self, why: str) -> None:
        """Bytes that are none of the protocol's."""
        self._refused.append(True)
        self._words = why

    def verdict(self) -> Verdict:
        if sum(self._refused) >= 3:
            return State.GARBAGE, self._words
        if self._repeats >= self._too_many():
            return State.STUCK, f"the same reading {self._repeats + 1} times: {self._last[-1][1]:.3f} m"
        spread_m, allowed_m = _spread(list(self._last))
        settled = len(self._last) >= 3 and np.less(*_spread(list(self._last)[-3:]))
        if len(self._last) == RANGES and spread_m > allowed_m and not settled:
            return State.GARBAGE, f"readings leap by {spread_m:.1f} m"
        return None

    def _too_many(self) -> int:
        """Equal readings in a row that are no chance: a steady vehicle and a coarse device repeat themselves."""
        return max(SAME_RANGES, ceil(log(FALSE_ALARM) / log(min(self._same / self._all, 0.99))))


def _spread(readings: list[tuple[int, float]]) -> tuple[float, float]:
    """Median absolute deviation of the ranges, and how much an honest approach may have, m."""
    middle = median(r for _, r in readings) if readings else 0.0
    span_s = (readings[-1][0] - readings[0][0]) / NS_PER_S if readings else 0.0
    return median([abs(r - middle) for _, r in readings] or [0.0]), RANGE_SPREAD_M + RANGE_SPEED_M_S * max(span_s, 0.0)
