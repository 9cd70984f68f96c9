"""The loop: for each sample of the source, the localizer's step, and every sink gets both."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from leadline.evaluation.accuracy import Errors, compare
from leadline.evaluation.running import Spread, Stamps, Tally, Thinned
from leadline.evaluation.summary import accuracy, pixel_cost_m, versions
from leadline.localizer import SmoothingLocalizer
from leadline.pipeline import folder
from leadline.pipeline.begin import begun
from leadline.pipeline.build import Job, Steps
from leadline.pipeline.recorder import Recorder
from leadline.pipeline.watch import Outlet, Watch
from leadline.rig import Rig
from leadline.samples import Array, LaserRange, Sample, Solution, StereoFrame
from leadline.sinks import McapSink, Sink, SolutionsCsv
from leadline.sinks.control import Control
from leadline.sinks.events import EventsCsv
from leadline.sources import Source
from leadline.sources.live import LiveSource
from leadline.sources.sync import arrival_ns

NOTICES_KEPT = 100
Progress = Callable[[int, int | None], None]  # frames done, frames in all (None: not known)


@dataclass(slots=True, eq=False)
class Track:
    """One method on its way through the samples."""

    name: str
    localizer: Steps
    sinks: list[Outlet]
    watch: Watch | None = None  # of the main one
    solutions: Thinned[Solution] = field(default_factory=Thinned)  # for the picture and the errors
    tally: Tally = field(default_factory=Tally)
    steps_s: Spread = field(default_factory=Spread)

    def take(self, sample: Sample) -> Solution | None:
        for sink in self.sinks:
            sink.sample(sample)
        start_s = time.perf_counter()
        solution = self.localizer.step(sample)
        if isinstance(sample, StereoFrame):
            self.steps_s.add(time.perf_counter() - start_s)
            if self.watch is not None:
                self.watch.found(sample, self.localizer.detections)
            for sink in self.sinks:
                sink.detections(sample, self.localizer.detections)
        if solution is not None:
            self.solutions.append(solution)
            self.tally.add(solution)
            for sink in self.sinks:
                sink.solution(solution)
            if self.watch is not None:
                self.watch.solved(solution)
        return solution


@dataclass(slots=True, eq=False)
class Passed:
    """What came by: frames and readings, these with the time, s, and the distance to the lit point."""

    frames: Stamps = field(default_factory=Stamps)
    readings: Stamps = field(default_factory=Stamps)
    lit: Thinned[tuple[float, float]] = field(default_factory=Thinned)
    start_ns: int = 0  # when the first sample came
    interrupted: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Report:
    """What a run came to; ``errors`` by method, empty arrays without truth; ``files`` as written."""

    out: Path
    summary: dict[str, Any]
    errors: dict[str, Errors]
    files: list[Path]


def run(
    job: Job,
    out: Path,
    *,
    record: bool = False,
    progress: Progress = lambda done, total: None,
    control: Control | None = None,
    say: Callable[[str], None] = lambda line: None,
) -> Report:
    """Take the source to its end, or to Ctrl-C, and write the run's folder. InputError where that cannot be done.

    Before the source has begun, nothing is written or taken away.

    control: for whoever wants to record, to stop and to mark while it runs. say: told what to know at once.
    """
    folder.check_folder(out, job.source.name)
    start_s = time.perf_counter()
    with ExitStack() as stack:
        stack.callback(job.source.close)
        watch = Watch(job.source, job.rig, job.detector)
        outputs = _outlets(job.outputs, stack, watch)  # they tell of devices that give nothing yet
        samples = begun(job.source, job.rig)
        if record and (kept := folder.keep_recording(out)) is not None:
            say(f"the earlier recording {out / folder.RECORDING} is now {kept}")
        folder.make_folder(out)
        (out / folder.CONFIG).write_text(job.config.dump(), encoding="utf-8")
        job.rig.save(out / folder.RIG)
        tracks = _tracks(job, out, stack, watch, outputs)
        recorder = _recorder(job, out, control or Control(), tracks[0], watch)
        stack.callback(recorder.close)
        if record:
            recorder.start(out / folder.RECORDING)
        passed = _drive(job, samples, tracks, recorder, progress)
        _close(stack, passed)
    wall_s = time.perf_counter() - start_s
    errors = {track.name: compare(track.solutions.values, job.source.truth, job.target) for track in tracks}
    summary = _summary(job, tracks, passed, errors, wall_s)
    summary["health"] = watch.health.summary()
    summary["unfinished"] = [one.words(passed.start_ns) for one in watch.unfinished]
    if summary["live"] is not None:
        summary["live"]["outputs_dropped"] = watch.dropped
    if isinstance(tracks[0].localizer, SmoothingLocalizer):
        smoothed = _write_smoothed(tracks[0].localizer, out / folder.SMOOTHED)
        summary["smoothed"] = {"accuracy": accuracy(compare(smoothed, job.source.truth, job.target))}
    (out / folder.SUMMARY).write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    _plot(job, tracks, passed, errors, out / folder.PICTURE)
    return Report(out, summary, errors, folder.written(out, recorder.files))


def _outlets(sinks: Iterable[Sink], stack: ExitStack, watch: Watch) -> list[Outlet]:
    outlets = [watch.outlet(sink) for sink in sinks]
    for outlet in outlets:
        stack.callback(outlet.close)
    return outlets


def _tracks(job: Job, out: Path, stack: ExitStack, watch: Watch, outputs: list[Outlet]) -> list[Track]:
    tracks = []
    for number, (name, localizer) in enumerate(job.methods.items()):
        main = number == 0
        tables: list[Sink] = [SolutionsCsv(out / (folder.SOLUTIONS if main else folder.solutions_name(name)))]
        if main:
            tables.append(EventsCsv(out / folder.EVENTS))
        outlets = [*_outlets(tables, stack, watch), *(outputs if main else [])]
        tracks.append(Track(name, localizer, outlets, watch if main else None))
    return tracks


def _recorder(job: Job, out: Path, control: Control, main: Track, watch: Watch) -> Recorder:
    def opened(path: Path) -> Sink:
        return McapSink(path, job.rig, job.source.truth)

    return Recorder(out, main.sinks, control, opened, watch, lambda: job.source.now_ns)


def _drive(job: Job, samples: Iterable[Sample], tracks: list[Track], recorder: Recorder, progress: Progress) -> Passed:
    passed = Passed()
    tell = job.source.idle

    def idle() -> None:
        recorder.poll()
        if tell is not None:
            tell()

    job.source.idle = idle
    try:
        for number, sample in enumerate(samples):
            if number == 0:
                passed.start_ns = arrival_ns(sample)
            recorder.poll()
            if isinstance(sample, StereoFrame):
                passed.frames.add(sample.t_ns)
            elif isinstance(sample, LaserRange):
                _note_reading(passed, job.rig, sample)
            for track in tracks:
                track.take(sample)
            if isinstance(sample, StereoFrame):
                progress(passed.frames.count, job.source.frame_count)
    except KeyboardInterrupt:
        passed.interrupted = True
    return passed


def _close(stack: ExitStack, passed: Passed) -> None:
    """Ctrl-C cuts short what hangs; the others are closed all the same, and the summary is written."""
    try:
        stack.close()
    except KeyboardInterrupt:
        passed.interrupted = True


def _write_smoothed(localizer: SmoothingLocalizer, path: Path) -> list[Solution]:
    smoothed = localizer.smoothed()
    table = SolutionsCsv(path)
    for solution in smoothed:
        table.solution(solution)
    table.close()
    return smoothed


def _note_reading(passed: Passed, rig: Rig, reading: LaserRange) -> None:
    passed.readings.add(reading.t_ns)
    lit = float("nan") if rig.laser is None else float(np.linalg.norm(rig.laser.point_m(reading.range_m)))
    passed.lit.append((reading.t_s, lit))


def _summary(job: Job, tracks: list[Track], passed: Passed, errors: dict[str, Errors], wall_s: float) -> dict[str, Any]:
    main = tracks[0]
    notices = job.source.notices
    summary: dict[str, Any] = {
        "source": job.source.name,
        "method": main.name,
        "target": job.target.name,
        "filtered": job.filtered,
        "seed": job.seed,
        "live": _live(job.source),
        "interrupted": passed.interrupted,
        "frames": passed.frames.count,
        "readings": passed.readings.count,
        **main.tally.summary(),
        "boxes": None if job.boxes is None else job.boxes.summary(),
        "agreement": main.localizer.notices,
        "notices": {"counts": job.source.notice_counts, "first": [str(notice) for notice in notices[:NOTICES_KEPT]]},
        "frame_rate_hz": passed.frames.rate_hz,
        "reading_rate_hz": passed.readings.rate_hz,
        "wall_s": wall_s,
        "frames_per_s": passed.frames.count / wall_s if wall_s > 0 else None,
        "step_ms": main.steps_s.times_ms(),
        "pixel_cost": _pixel_cost(job.rig, main.solutions.values),
        "accuracy": accuracy(errors[main.name], own_point=main.name == "paper"),
        "versions": versions(),
    }
    if len(tracks) > 1:
        summary["beside"] = {
            track.name: {
                **track.tally.summary(),
                "step_ms": track.steps_s.times_ms(),
                "accuracy": accuracy(errors[track.name], own_point=track.name == "paper"),
            }
            for track in tracks[1:]
        }
    return summary


def _live(source: Source) -> dict[str, int] | None:
    """Frames that overload cost, and how often a device was opened again; None for a recorded dive."""
    return {"dropped": source.dropped, "restarts": source.restarts} if isinstance(source, LiveSource) else None


def _pixel_cost(rig: Rig, solutions: list[Solution]) -> dict[str, float] | None:
    """What a pixel of disparity costs at the run's median range."""
    ranges = [s.range_m for s in solutions if s.range_m is not None]
    if not ranges:
        return None
    range_m = float(np.median(ranges))
    cost = pixel_cost_m(rig, range_m)
    return None if cost is None else {"range_m": range_m, "m_per_px": cost}


def _plot(job: Job, tracks: list[Track], passed: Passed, errors: dict[str, Errors], path: Path) -> None:
    from leadline.evaluation.plot import Curve, Picture, plot_run  # noqa: PLC0415  matplotlib is slow to import

    curves = [Curve(t.name, t.solutions.values, errors[t.name], t.name == "paper") for t in tracks]
    laser: Array = np.array(passed.lit.values, dtype=np.float64).reshape(-1, 2)
    title = f"{Path(job.source.name).name} · {job.target.name} · {curves[0].name}"
    plot_run(path, Picture(title, curves[0], job.source.truth, laser, curves[1] if len(curves) > 1 else None))
