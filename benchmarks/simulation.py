"""Stereo frames a second of the simulator at 640x360, both cameras at once, over the whole of each dive."""

from __future__ import annotations

import sys
import time

from leadline.samples import StereoFrame
from leadline.simulation.dive import SimulatedDive
from leadline.simulation.scenario import shipped_scenarios

PROMISED_HZ = 10.0
_BATCH = 10


def frame_rate(scenario: str, frames: int = 60) -> float:
    """The median over batches, so that a moment of other work on the machine does not count."""
    dive = SimulatedDive(scenario)
    every = max(1, dive.frame_count // frames)
    dive._frame_times = dive._frame_times[::every]  # the near frames cost more: take them all along the way
    rates, start, count = [], None, 0
    for sample in dive.samples():
        if not isinstance(sample, StereoFrame):
            continue
        now = time.perf_counter()
        if start is None:
            start = now
        elif (count := count + 1) % _BATCH == 0:
            rates.append(_BATCH / (now - start))
            start = now
    return sorted(rates)[len(rates) // 2]


def main() -> bool:
    """Print a table; whether every scenario keeps the promise."""
    rates = {name: frame_rate(name) for name in shipped_scenarios()}
    print(f"simulation, 640x360, stereo frames/s (promised {PROMISED_HZ:g} on 2 free cores)")
    for name, rate in rates.items():
        print(f"  {name:10s} {rate:6.1f}{'' if rate >= PROMISED_HZ else '  too slow'}")
    return min(rates.values()) >= PROMISED_HZ


if __name__ == "__main__":
    sys.exit(0 if main() else 1)
