"""Time several functions in turn, so that a busy machine slows all of them alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from statistics import median
from time import perf_counter


def seconds(functions: Mapping[str, Callable[[], object]], rounds: int = 25) -> dict[str, float]:
    """Median seconds of each function over interleaved rounds, after one round that is not counted."""
    times: dict[str, list[float]] = {name: [] for name in functions}
    for turn in range(rounds + 1):
        for name, function in functions.items():
            start = perf_counter()
            function()
            if turn:
                times[name].append(perf_counter() - start)
    return {name: median(taken) for name, taken in times.items()}
