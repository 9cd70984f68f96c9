"""Is there anything in what comes? Pictures that are black, frozen or noise; ranges that stand still or leap."""

from __future__ import annotations

from collections import deque
from math import ceil, log
from statistics import median

import numpy as np
from numpy.typing import NDArray

from leadline.health.states import State, Verdict
from leadline.samples import NS_PER_S, Image, LaserRange

STEP = 8  # every eighth pixel is looked at
BLACK, FLAT, NOISE = 6.0, 0.8, 32.0  # grey levels: mean; standard deviation; difference between neighbours
SAME_PICTURES = 2  # repeats in a row
BAD_PICTURES = 2
MOVED_S, MOVED_RATIO, MOVED_LEVEL = 0.7, 1.4, 0.5  # pictures so far apart differ more than neighbours do, grey levels
SAME_RANGES, SAME_S = 5, 0.8  # repeats in a row, lasting so long
COARSE_M = 0.005  # a device that rounds to more repeats itself
RANGES = 6
RANGE_SPREAD_M, RANGE_SPEED_M_S = 0.3, 0.5
LEAPS, LEAPS_OF = 5, 6  # between readings; two strays among good ones make four
FALSE_ALARM = 1e-5  # a run of equal readings that had this chance is a stuck device: at 3 Hz once in 9 h


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


class Scene:
    """Does what the camera sees change? Where it does, a laser that does not is stuck; where it does not, who knows."""

    def __init__(self) -> None:
        self._kept: deque[tuple[int, NDArray[np.float32]]] = deque(maxlen=64)
        self._noise: float | None = None  # of one picture against the next: the least seen lately
        self.moving = False

    def look(self, t_ns: int, image: Image) -> None:
        step = max(1, image.shape[1] // 80)
        small = image[::step, ::step].astype(np.float32)
        if self._kept and self._kept[-1][1].shape == small.shape:
            change = float(np.abs(small - self._kept[-1][1]).mean())
            self._noise = change if self._noise is None else min(change, self._noise * 1.003)
            while len(self._kept) > 1 and t_ns - self._kept[1][0] >= MOVED_S * NS_PER_S:
                self._kept.popleft()
            if t_ns - self._kept[0][0] >= MOVED_S * NS_PER_S:
                far = float(np.abs(small - self._kept[0][1]).mean())
                self.moving = far > MOVED_RATIO * self._noise + MOVED_LEVEL
        self._kept.append((t_ns, small))


class Ranges:
    """The laser's readings by themselves, and beside a moving scene."""

    def __init__(self) -> None:
        self._since_ns = 0  # of the present value
        self._moved = 0  # readings of the present value while the scene moved
        self._fine = False
        self._last: deque[tuple[int, float]] = deque(maxlen=RANGES)
        self._leaps: deque[bool] = deque(maxlen=LEAPS_OF)
        self._repeats = 0
        self._same, self._all = 0.0, 0.0  # how often a reading equals the one before while the scene moves, as learnt
        self._refused: deque[bool] = deque(maxlen=5)
        self._words = ""

    def read(self, reading: LaserRange, *, moving: bool) -> None:
        self._fine |= abs(reading.range_m / COARSE_M - round(reading.range_m / COARSE_M)) > 0.01
        same = bool(self._last) and reading.range_m == self._last[-1][1]
        if not same:
            self._since_ns, self._repeats, self._moved = reading.t_ns, 0, 0
        else:
            self._repeats += 1
            self._moved += moving
        if moving and self._repeats < SAME_RANGES:
            self._same, self._all = self._same * 0.999 + same, self._all * 0.999 + 1
        if self._last:
            gone_m, allowed_m = _spread([self._last[-1], (reading.t_ns, reading.range_m)])
            self._leaps.append(gone_m > allowed_m / 2)
        self._last.append((reading.t_ns, reading.range_m))
        self._refused.append(False)

    def refuse(self, why: str) -> None:
        """Bytes that are none of the protocol's."""
        self._refused.append(True)
        self._words = why

    def verdict(self) -> Verdict:
        if sum(self._refused) >= 3:
            return State.GARBAGE, self._words
        if self._stuck():
            return State.STUCK, f"the same reading {self._repeats + 1} times: {self._last[-1][1]:.3f} m"
        spread_m, allowed_m = _spread(list(self._last))
        settled = len(self._last) >= 3 and np.less(*_spread(list(self._last)[-3:]))
        leaping = sum(self._leaps) >= LEAPS or (len(self._last) == RANGES and spread_m > allowed_m)
        if leaping and not settled:
            return State.GARBAGE, f"readings leap by {spread_m:.1f} m"
        return None

    def _stuck(self) -> bool:
        """Equal readings for longer than chance explains, while what the cameras see goes on changing."""
        if self._repeats < SAME_RANGES or self._moved < 0.8 * self._repeats:
            return False
        prior = 0.1 if self._fine else 0.9
        often = (self._same + 50 * prior) / (self._all + 50)
        lasted_s = (self._last[-1][0] - self._since_ns) / NS_PER_S
        return lasted_s >= SAME_S and self._repeats >= ceil(log(FALSE_ALARM) / log(min(often, 0.99)))


def _spread(readings: list[tuple[int, float]]) -> tuple[float, float]:
    """Median absolute deviation of the ranges, and how much an honest approach may have, m."""
    middle = median(r for _, r in readings) if readings else 0.0
    span_s = (readings[-1][0] - readings[0][0]) / NS_PER_S if readings else 0.0
    return median([abs(r - middle) for _, r in readings] or [0.0]), RANGE_SPREAD_M + RANGE_SPEED_M_S * max(span_s, 0.0)
