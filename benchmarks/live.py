"""15 stereo frames a second at 1280 x 720 with the shipped detector, as live: how late are the solutions, and why?

    python -m benchmarks.live [--seconds 30] [--long-side 320] [--page] [--profile]

Latency is from a frame's arrival to its solution, through the inbox (two frames wait at most, the oldest is dropped),
the detector, the localizer and the sinks' queues. ``--page`` opens the live page in a Chromium on the same processor
and counts its drawings. On a busy machine the figures are the machine's.
"""

from __future__ import annotations

import argparse
import cProfile
import os
import pstats
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from multiprocessing import get_context
from multiprocessing.queues import SimpleQueue
from multiprocessing.synchronize import Event
from pathlib import Path

import numpy as np

from leadline.guidance import Guide
from leadline.localizer import Localizer
from leadline.pipeline.loop import Track
from leadline.pipeline.watch import Watch, WatchedFinder
from leadline.recognition.detector import Detector
from leadline.samples import NS_PER_S, Sample, StereoFrame
from leadline.simulation.dive import SimulatedDive
from leadline.simulation.scenario import Scenario
from leadline.sinks import SolutionsCsv
from leadline.sinks.control import Control
from leadline.sinks.web import WebSink
from leadline.sinks.web_access import Place
from leadline.sinks.web_server import PageServer
from leadline.sources import Source
from leadline.sources.replay import live_dive
from leadline.target import Sphere

RATE_HZ, LONGEST_MS, PAGE_HZ = 15.0, 150.0, 10.0
RENDERED_S, WARM_S = 3.0, 2.0


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


@dataclass(slots=True)
class Result:
    """Latencies of the frames, ms; frames dropped; drawings of the page in each second."""

    late_ms: list[float] = field(default_factory=list)
    dropped: int = 0
    page_hz: list[float] = field(default_factory=list)

    @property
    def good(self) -> bool:
        short = float(np.percentile(self.late_ms, 99)) <= LONGEST_MS
        return short and (not self.page_hz or float(np.median(self.page_hz)) >= PAGE_HZ)

    def __str__(self) -> str:
        p50, p99 = np.percentile(self.late_ms, [50, 99])
        page = ""
        if self.page_hz:
            page = f"; page drawn {np.median(self.page_hz):.0f} times a second (least {min(self.page_hz):.0f})"
        return f"{len(self.late_ms)} frames: latency p50 {p50:.0f} ms, p99 {p99:.0f} ms; {self.dropped} dropped{page}"


def measure(seconds: float, long_side_px: int, out: Path, *, page: bool, profile: cProfile.Profile | None) -> Result:
    dive, result = scene(), Result()
    source = live_dive(ToAndFro(dive, seconds))
    detector = Detector(long_side_px=long_side_px)
    detector.warm_up(dive.rig.left.width, dive.rig.left.height)
    finder = WatchedFinder(detector, live=True)
    watch = Watch(source, dive.rig, finder)
    outlets = [watch.outlet(SolutionsCsv(out / "solutions.csv"))]
    target = Sphere(0.34)
    sink = WebSink("live", dive.rig, target, Guide(dive.rig), Control(), ())
    with looked_at(sink, result) if page else nullcontext():
        outlets += [watch.outlet(sink)] if page else []
        track = Track("fused", Localizer(dive.rig, target, finder), outlets, watch)
        if profile is not None:
            profile.enable()
        for sample in source:
            track.take(sample)
            if isinstance(sample, StereoFrame) and sample.t_ns > WARM_S * NS_PER_S:
                result.late_ms.append((source.clock.now_ns() - (sample.arrival_ns or sample.t_ns)) / 1e6)
        if profile is not None:
            profile.disable()
    for outlet in outlets:
        outlet.close()
    result.dropped = source.dropped
    return result


@contextmanager
def looked_at(sink: WebSink, result: Result) -> Iterator[None]:
    """The page served, and a Chromium in another process that has it open."""
    server, context = PageServer(sink, Place(port=0), None, lambda: ()), get_context("spawn")
    server.start()
    rates: SimpleQueue[float | None] = context.SimpleQueue()
    over = context.Event()
    visitor = context.Process(target=_visit, args=(server.url, rates, over), daemon=True)
    visitor.start()
    rates.get()  # it is there
    try:
        yield
    finally:
        over.set()
        while (rate := rates.get()) is not None:
            result.page_hz.append(rate)
        visitor.join()
        server.close()


def _visit(url: str, rates: SimpleQueue[float | None], over: Event) -> None:
    from playwright.sync_api import sync_playwright  # noqa: PLC0415  of the development tools

    chromium = os.environ.get("LEADLINE_CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(url)
        rates.put(None)
        while not over.wait(1.0):
            if (rate := page.locator("#rates").get_attribute("data-rate")) is not None:
                rates.put(float(rate))
        browser.close()
    rates.put(None)


def main(words: Sequence[str] | None = None) -> bool:
    """Print the latencies; whether 99 % of them are short, and the page drawn often enough."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.live")
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--long-side", type=int, default=320, help="of the detector's input, px")
    parser.add_argument("--page", action="store_true", help="with the live page open in Chromium")
    parser.add_argument("--profile", action="store_true", help="what dominates")
    options = parser.parse_args(words)
    profile = cProfile.Profile() if options.profile else None
    with tempfile.TemporaryDirectory() as folder:
        result = measure(options.seconds, options.long_side, Path(folder), page=options.page, profile=profile)
    print(result)
    if profile is not None:
        pstats.Stats(profile).sort_stats("tottime").print_stats(15)
    return result.good


if __name__ == "__main__":
    sys.exit(0 if main() else 1)
