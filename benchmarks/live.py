"""15 stereo frames a second at 1280 x 720 with the shipped detector, as live: how late are the solutions, and why?

    python -m benchmarks.live [--seconds 30] [--profile]

Latency is from a frame's arrival to its solution, through the inbox (two frames wait at most, the oldest is dropped),
the detector, the localizer and the sinks' queues. On a busy machine the figures are the machine's.
"""

from __future__ import annotations

import argparse
import cProfile
import pstats
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from leadline.localizer import Localizer
from leadline.pipeline.loop import Track
from leadline.pipeline.watch import Watch, WatchedFinder
from leadline.recognition.detector import Detector
from leadline.samples import NS_PER_S, Sample, StereoFrame
from leadline.simulation.dive import SimulatedDive
from leadline.simulation.scenario import Scenario
from leadline.sinks import SolutionsCsv
from leadline.sources import Source
from leadline.sources.replay import live_dive
from leadline.target import Sphere

RATE_HZ, LONGEST_MS = 15.0, 150.0
RENDERED_S = 3.0


class ToAndFro(Source):
    """A short dive again and again, forwards and backwards."""

    def __init__(self, dive: SimulatedDive, seconds: float) -> None:
        super().__init__("to and fro")
        self.rig, self._seconds = dive.rig, seconds
        self._samples = list(dive.samples())

    def read(self) -> Iterator[Sample]:
        first_ns, last_ns = self._samples[0].t_ns, self._samples[-1].t_ns
        base_ns, way = 0, 1
        while base_ns < self._seconds * NS_PER_S:
            for one in self._samples[::way]:
                t_ns = base_ns + (one.t_ns - first_ns if way > 0 else last_ns - one.t_ns)
                yield replace(one, t_ns=t_ns, arrival_ns=t_ns + 1)
            base_ns += last_ns - first_ns + round(NS_PER_S / RATE_HZ)
            way = -way


def scene() -> SimulatedDive:
    scenario = Scenario.load("demo")
    path = scenario.path.model_copy(
        update={"start_m": 1.6, "end_m": 1.3, "speed_m_s": 0.3 / RENDERED_S, "dwell_s": 0.0}
    )
    camera = scenario.camera.model_copy(update={"image_width_px": 1280, "rate_hz": RATE_HZ, "jitter_s": 0.0})
    return SimulatedDive(scenario.model_copy(update={"path": path, "camera": camera}), seed=1)


def measure(seconds: float, out: Path, profile: cProfile.Profile | None) -> tuple[list[float], int]:
    """Latencies of the frames, ms, and how many were dropped."""
    dive = scene()
    source = live_dive(ToAndFro(dive, seconds))
    detector = Detector()
    detector.warm_up(dive.rig.left.width, dive.rig.left.height)
    finder = WatchedFinder(detector, live=True)
    watch = Watch(source, dive.rig, finder)
    outlet = watch.outlet(SolutionsCsv(out / "solutions.csv", live=True))
    track = Track("fused", Localizer(dive.rig, Sphere(0.34), finder), [outlet], watch)
    late_ms: list[float] = []
    if profile is not None:
        profile.enable()
    for sample in source:
        track.take(sample)
        if isinstance(sample, StereoFrame) and sample.t_ns > 2 * NS_PER_S:  # warm by then
            late_ms.append((source.clock.now_ns() - (sample.arrival_ns or sample.t_ns)) / 1e6)
    if profile is not None:
        profile.disable()
    outlet.close()
    return late_ms, source.dropped


def main(words: Sequence[str] | None = None) -> bool:
    """Print the latencies; whether 99 % of them are short."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.live")
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--profile", action="store_true", help="what dominates")
    options = parser.parse_args(words)
    profile = cProfile.Profile() if options.profile else None
    with tempfile.TemporaryDirectory() as folder:
        late_ms, dropped = measure(options.seconds, Path(folder), profile)
    p50, p99 = np.percentile(late_ms, [50, 99])
    print(f"{len(late_ms)} frames: latency p50 {p50:.0f} ms, p99 {p99:.0f} ms; {dropped} dropped")
    if profile is not None:
        pstats.Stats(profile).sort_stats("tottime").print_stats(15)
    return bool(p99 <= LONGEST_MS)


if __name__ == "__main__":
    sys.exit(0 if main() else 1)
