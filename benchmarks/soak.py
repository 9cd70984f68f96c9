"""A dive that goes on for a day, through ``leadline run``'s own loop: is memory bounded, and does it stay as quick?

    python -m benchmarks.soak [--hours 24] [--footage FILE]

Images come once a second, readings, motion and clock at full rate; time is simulated, all goes as fast as it can. The
pictures are ``benchmarks.faults_dive``'s, to and fro. Times are of the loop's own thread (CPU), for a busy machine.
"""

from __future__ import annotations

import argparse
import gc
import os
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from benchmarks.faults_dive import DIAMETER_M, Footage, footage
from leadline.config import Config
from leadline.localizer import Localizer
from leadline.pipeline.build import Job
from leadline.pipeline.loop import run
from leadline.pipeline.watch import WatchedFinder
from leadline.samples import NS_PER_S, Detection, LaserRange, Sample, StereoFrame, VehicleMotion
from leadline.sources import Source
from leadline.target import Sphere

LASER_HZ, MOTION_HZ = 3, 5
PARTS = 10
EVERY_S = 300
SLOPE_MB_H, RATIO, TIMES = 1.0, 1.1, 20.0


@dataclass(slots=True)
class Load:
    """Hours into the dive; resident memory, MB; threads; open files."""

    hours: float
    memory_mb: float
    threads: int
    descriptors: int


@dataclass(slots=True)
class Result:
    loads: list[Load] = field(default_factory=list)
    took_s: list[list[float]] = field(
        default_factory=lambda: [[] for _ in range(PARTS)]
    )  # frames, by tenths of the run
    wall_s: float = 0.0

    @property
    def slope_mb_h(self) -> float:
        """Of the memory, once the first tenth has filled what is kept."""
        later = self.loads[max(len(self.loads) // PARTS, 1) :]
        return float(np.polyfit([one.hours for one in later], [one.memory_mb for one in later], 1)[0])

    @property
    def ratio(self) -> float:
        """99th percentile of a frame's time in the last tenth, in the first one's."""
        return float(np.percentile(self.took_s[-1], 99) / np.percentile(self.took_s[0], 99))

    @property
    def steady(self) -> bool:
        """Whether there are no more threads and descriptors at the end than after the first tenth."""
        early, late = self.loads[max(len(self.loads) // PARTS, 1)], self.loads[-1]
        return late.threads <= early.threads and late.descriptors <= early.descriptors


class Endless(Source):
    """The footage to and fro, one pair a second."""

    live = True

    def __init__(self, film: Footage, hours: float, result: Result) -> None:
        super().__init__("soak")
        self._pairs = [one for one in film.samples if isinstance(one, StereoFrame)]
        self._film, self._hours, self._result = film, hours, result

    def read(self) -> Iterator[Sample]:
        rng = np.random.default_rng(0)
        seconds, there_and_back = round(self._hours * 3600), [*range(len(self._pairs)), *range(len(self._pairs))[::-1]]
        for second in range(seconds):
            pair = self._pairs[there_and_back[second % len(there_and_back)]]
            if second % EVERY_S == 0:
                self._result.loads.append(_load(second / 3600))
            if second and second % (seconds // PARTS) == 0:
                print(self._result.loads[-1], flush=True)  # what there is, should it not come to its end
            t_ns = second * NS_PER_S
            start_s = time.thread_time()
            yield replace(pair, t_ns=t_ns, arrival_ns=t_ns + 80_000_000, left_t_ns=None, right_t_ns=None)
            self._result.took_s[PARTS * second // seconds].append(time.thread_time() - start_s)
            yield from self._others(t_ns, self._film.truth[pair.t_ns].range_m, rng)
        self._result.loads.append(_load(seconds / 3600))

    def _others(self, t_ns: int, range_m: float, rng: np.random.Generator) -> Iterator[Sample]:
        """A second of readings, motion and the computer's clock."""
        laser = [t_ns + 100_000_000 + i * NS_PER_S // LASER_HZ for i in range(LASER_HZ)]
        motion = [t_ns + 110_000_000 + i * NS_PER_S // MOTION_HZ for i in range(MOTION_HZ)]
        for one_ns in sorted(laser + motion):
            assert self.health is not None
            self.health.wall_clock(one_ns, one_ns)
            self._now_ns = max(self._now_ns, one_ns)
            if one_ns in laser:
                yield LaserRange(one_ns, round(range_m + rng.normal(0, 0.003), 3), 0.9, one_ns + 30_000_000)
            else:
                yield VehicleMotion(one_ns, rotation_rad_s=(0.0, 0.0, 0.0), arrival_ns=one_ns + 20_000_000)


class KnownBoxes:
    def __init__(self, film: Footage) -> None:
        self._film = film

    def find(self, frame: StereoFrame) -> list[Detection]:
        box = self._film.boxes_px.get(frame.name)
        return [] if box is None else [Detection(box, 0.9)]


def _load(hours: float) -> Load:
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    memory_mb = pages * os.sysconf("SC_PAGE_SIZE") / 2**20
    return Load(hours, memory_mb, threading.active_count(), sum(1 for _ in Path("/proc/self/fd").iterdir()))


def soak(film: Footage, hours: float, out: Path) -> Result:
    result = Result()
    source = Endless(film, hours, result)
    finder = WatchedFinder(KnownBoxes(film), live=True)
    target, config = Sphere(DIAMETER_M), Config()
    methods = {"fused": Localizer(film.rig, target, finder, config)}
    start_s = time.monotonic()
    run(Job(source, film.rig, target, config, dict(methods), seed=0, detector=finder), out)
    result.wall_s = time.monotonic() - start_s
    return result


def main(words: Sequence[str] | None = None) -> bool:
    """Print the figures; whether all are as promised."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.soak")
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--footage", type=Path, help="keeps the rendered pictures")
    options = parser.parse_args(words)
    with tempfile.TemporaryDirectory() as folder:
        result = soak(footage(options.footage), options.hours, Path(folder) / "run")
    first, last, times = result.loads[0], result.loads[-1], options.hours * 3600 / result.wall_s
    p99_ms = [1e3 * float(np.percentile(part, 99)) for part in result.took_s]
    cpu_s = sum(map(sum, result.took_s))
    print(
        f"{options.hours:.2f} h at {times:.0f} times real time ({cpu_s:.0f} s of CPU for the frames): memory "
        f"{first.memory_mb:.0f} -> {last.memory_mb:.0f} MB, {result.slope_mb_h:+.2f} MB/h after the first tenth; "
        f"threads {first.threads} -> {last.threads}, descriptors {first.descriptors} -> {last.descriptors}; "
        f"p99 of a frame {p99_ms[0]:.1f} -> {p99_ms[-1]:.1f} ms ({result.ratio:.2f})"
    )
    return result.slope_mb_h < SLOPE_MB_H and result.ratio <= RATIO and result.steady and times >= TIMES


if __name__ == "__main__":
    sys.exit(0 if main() else 1)
