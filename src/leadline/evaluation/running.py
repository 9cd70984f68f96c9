"""What is known of a run at any time, in bounded memory: it may go on for weeks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any, Generic, TypeVar

import numpy as np

from leadline.samples import NS_PER_S, Solution, Stage, Status

KEPT = 16_384  # of each kind: the whole of an ordinary dive, an hour and a half of it at 3 Hz, 18 min at 15 Hz
T = TypeVar("T")


class Thinned(Generic[T]):
    """All that was added, or, where that is more than ``most``, an even choice of it: every 2nd, 4th, 8th ..., so that
    medians and pictures stay those of the whole run."""

    def __init__(self, values: Iterable[T] = (), *, most: int = KEPT) -> None:
        self.values: list[T] = []
        self.count = 0  # of all
        self._most, self._step = most, 1
        for value in values:
            self.append(value)

    def append(self, value: T) -> None:
        if self.count % self._step == 0:
            if len(self.values) == self._most:
                del self.values[1::2]
                self._step *= 2
            if self.count % self._step == 0:
                self.values.append(value)
        self.count += 1

    def clear(self) -> None:
        self.values.clear()
        self.count, self._step = 0, 1


class Spread:
    """Of numbers: least and largest exactly, median and percentiles of an even choice where they are many."""

    def __init__(self) -> None:
        self._kept: Thinned[float] = Thinned()
        self._least, self._most = float("inf"), float("-inf")

    def add(self, value: float) -> None:
        self._kept.append(value)
        self._least, self._most = min(self._least, value), max(self._most, value)

    def summary(self) -> dict[str, float] | None:
        if not self._kept.count:
            return None
        return {"min": float(self._least), "median": self.percentile(50), "max": float(self._most)}

    def times_ms(self) -> dict[str, float] | None:
        """Of seconds."""
        if not self._kept.count:
            return None
        return {"median": 1e3 * self.percentile(50), "p95": 1e3 * self.percentile(95), "max": 1e3 * self._most}

    def percentile(self, share: float) -> float:
        return float(np.percentile(self._kept.values, share))


class Stamps:
    """How many came, and how many a second."""

    def __init__(self, stamps_ns: Iterable[int] = ()) -> None:
        self.count = 0
        self._first_ns = self._last_ns = 0
        for t_ns in stamps_ns:
            self.add(t_ns)

    def add(self, t_ns: int) -> None:
        self._first_ns = min(self._first_ns, t_ns) if self.count else t_ns
        self._last_ns = max(self._last_ns, t_ns) if self.count else t_ns
        self.count += 1

    @property
    def rate_hz(self) -> float | None:
        """None for fewer than two."""
        span_s = (self._last_ns - self._first_ns) / NS_PER_S
        return (self.count - 1) / span_s if span_s > 0 else None


class Tally:
    """Counts by stage, status, use and rejection, and the range with its stated sigma (valid solutions), metres."""

    def __init__(self, solutions: Iterable[Solution] = ()) -> None:
        self._count = 0
        self._stages: Counter[Stage] = Counter()
        self._status: Counter[Status] = Counter()
        self._used: Counter[str] = Counter()
        self._rejected: Counter[str] = Counter()
        self._range_m, self._sigma_m = Spread(), Spread()
        for solution in solutions:
            self.add(solution)

    def add(self, solution: Solution) -> None:
        self._count += 1
        self._stages[solution.stage] += 1
        self._status[solution.status] += 1
        self._used.update(str(kind) for kind in solution.used)
        self._rejected.update(f"{one.kind}: {one.reason}" for one in solution.rejected)
        if solution.status is not Status.VALID:
            return
        if solution.range_m is not None:
            self._range_m.add(solution.range_m)
        if solution.range_sigma_m is not None:
            self._sigma_m.add(solution.range_sigma_m)

    def summary(self) -> dict[str, Any]:
        return {
            "solutions": self._count,
            "stages": {str(int(stage)): self._stages[stage] for stage in Stage},
            "status": {str(status): self._status[status] for status in Status},
            "used": dict(sorted(self._used.items())),
            "rejected": dict(sorted(self._rejected.items())),
            "range_m": self._range_m.summary(),
            "range_sigma_m": self._sigma_m.summary(),
        }
