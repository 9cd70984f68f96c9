"""The health of a run: what the loop tells it of the detector, the disk and the outputs, and whom it is told to."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from leadline.errors import InputError
from leadline.health import Condition, Health, Part, State
from leadline.pipeline.worker import Answer, Clock, Job, Worker
from leadline.recognition.finder import Finder
from leadline.rig import Rig
from leadline.samples import NS_PER_S, Detection, Sample, Solution, Status, StereoFrame
from leadline.sinks import CheckedSink, EventSink, HealthSink, Sink
from leadline.sinks.control import Event
from leadline.sources import Source

TOLD_EVERY_S = 1.0
CLOSE_S = 10.0  # for a sink to finish what waits
IN_VIEW = 0.1  # a target must be this far from the image's edge (part of its size) to be missed by the detector
DETECTED_WITHIN_M = (0.7, 3.0)  # nearer it fills the view, farther it may be too small


class WatchedFinder:
    """A detector, timed. live: an error of its is told and counts as no detection; the dive goes on without it."""

    def __init__(self, finder: Finder, *, live: bool, clock: Clock = time.perf_counter) -> None:
        self._finder, self._live, self._clock = finder, live, clock
        self.took_s = 0.0
        self.error = ""

    def find(self, frame: StereoFrame) -> list[Detection]:
        start_s = self._clock()
        self.error = ""
        try:
            return self._finder.find(frame)
        except Exception as error:
            if not self._live:
                raise
            self.error = f"{type(error).__name__}: {error}"
            return []
        finally:
            self.took_s = self._clock() - start_s


@dataclass(frozen=True, slots=True)
class Unfinished:
    """A sink that lacks what it was given from ``since_ns`` on; why: empty where it was stuck."""

    name: str
    since_ns: int
    why: str = ""

    def words(self, start_ns: int) -> str:
        """start_ns: of the dive."""
        into_s = max(self.since_ns - start_ns, 0) / NS_PER_S
        if not self.why:
            return f"{self.name} was stuck: what it was given from {into_s:.1f} s into the dive on is lost"
        return f"{self.name} stopped {into_s:.1f} s into the dive: {self.why}; it holds what came before"


class Outlet:
    """A sink whose work is watched.

    live: it works in its own thread; an error of its (a full disk) is told, and the dive goes on without it.
    """

    def __init__(
        self,
        sink: Sink,
        health: Health,
        now_ns: Callable[[], int],
        *,
        live: bool,
        clock: Clock,
        tell: Callable[[Unfinished], None] = lambda unfinished: None,
    ) -> None:
        self._sink, self._health, self._now_ns, self._clock, self._tell = sink, health, now_ns, clock, tell
        self._took_s = 0.0  # for one sample and what followed it, where there is no thread
        self._failing_ns: int | None = None  # when it was given the first thing of those that fail now
        self.part: Part = getattr(sink, "part", Part.OUTPUT)
        self.name: str = getattr(sink, "name", type(sink).__name__)
        self.worker = Worker(type(sink).__name__, clock) if live else None

    @property
    def dropped(self) -> int:
        """Jobs that it could not do in time."""
        return 0 if self.worker is None else self.worker.dropped

    def sample(self, sample: Sample) -> None:
        self._do(lambda: self._sink.sample(sample), picture=isinstance(sample, StereoFrame))

    def detections(self, frame: StereoFrame, detections: Sequence[Detection]) -> None:
        kept = list(detections)
        self._do(lambda: self._sink.detections(frame, kept), picture=True)

    def solution(self, solution: Solution) -> None:
        self._do(lambda: self._conclude(solution), last=True)

    def health(self, conditions: Sequence[Condition], now_ns: int) -> None:
        if isinstance(self._sink, HealthSink):
            sink = self._sink
            self._do(lambda: sink.health(conditions, now_ns))

    def event(self, event: Event) -> None:
        if isinstance(self._sink, EventSink):
            sink = self._sink
            self._do(lambda: sink.event(event))

    def collect(self) -> None:
        """Tell the health what has been done since, and what has not."""
        if self.worker is None:
            return
        now_ns = self._now_ns()
        for answer in self.worker.answers():
            if isinstance(answer.error, InputError):
                raise answer.error
            self._note(answer)
            fault = None if answer.error is None else _as_verdict(answer.error)
            late_s = (now_ns - answer.given_ns) / NS_PER_S - answer.took_s
            self._health.done(self.part, now_ns, answer.took_s, fault, late_s, who=self.name)
        if (waiting_ns := self.worker.waiting_ns) is not None:
            self._health.asked(self.part, waiting_ns, now_ns, who=self.name)

    def close(self) -> None:
        """Finish what waits, but for a sink that hangs: it is left to itself, and that is told."""
        if self.worker is None:
            self._sink.close()
        elif self._ended(self.worker):
            try:
                self._sink.close()
            except OSError as error:
                self._health.reported(self.part, *_as_verdict(error), self._now_ns())
                since_ns = self._now_ns() if self._failing_ns is None else self._failing_ns
                self._tell(Unfinished(self.name, since_ns, error.strerror or str(error)))

    def _ended(self, worker: Worker) -> bool:
        """Whether it has done all in time, or before Ctrl-C."""
        ended = False
        try:
            ended = worker.close(CLOSE_S)
        finally:
            for answer in worker.answers():
                self._note(answer)
            waiting_ns = worker.waiting_ns
            if not ended and waiting_ns is not None:
                self._tell(Unfinished(self.name, waiting_ns))
        return ended

    def _note(self, answer: Answer) -> None:
        if answer.error is None:
            self._failing_ns = None
        elif self._failing_ns is None:
            self._failing_ns = answer.given_ns

    def _conclude(self, solution: Solution) -> None:
        self._sink.solution(solution)
        if isinstance(self._sink, CheckedSink) and (amiss := self._sink.check()) is not None:
            raise Amiss(amiss)

    def _do(self, work: Callable[[], None], *, picture: bool = False, last: bool = False) -> None:
        if self.worker is None:
            start_s = self._clock()
            work()
            self._took_s += self._clock() - start_s
            if last:
                self._health.done(self.part, self._now_ns(), self._took_s, who=self.name)
                self._took_s = 0.0
            return
        self.worker.give(Job(work, self._now_ns(), picture, last))
        self.collect()


class Amiss(Exception):  # noqa: N818  what a sink found wrong with its own work
    def __init__(self, verdict: tuple[State, str]) -> None:
        super().__init__(verdict[1])
        self.verdict = verdict


def _as_verdict(error: Exception) -> tuple[State, str]:
    if isinstance(error, Amiss):
        return error.verdict
    return State.OFF, f"{error}" if isinstance(error, OSError) else f"{type(error).__name__}: {error}"


class Watch:
    """Feeds a run's health and tells it to the sinks that take it."""

    def __init__(
        self, source: Source, rig: Rig, finder: WatchedFinder | None, clock: Clock = time.perf_counter
    ) -> None:
        self.health = Health()
        self._clock = clock
        self._source, self._rig, self._finder = source, rig, finder
        self._outlets: list[Outlet] = []
        self._dropped = 0  # by those that have been released
        self.unfinished: list[Unfinished] = []  # sinks that lack something in the end
        self._told: tuple[tuple[Condition, ...], int] = (), 0
        self._last: Solution | None = None
        source.health = self.health
        source.idle = self.tell

    def outlet(self, sink: Sink) -> Outlet:
        outlet = Outlet(
            sink,
            self.health,
            lambda: self._source.now_ns,
            live=self._source.live,
            clock=self._clock,
            tell=self.unfinished.append,
        )
        self._outlets.append(outlet)
        return outlet

    def release(self, outlet: Outlet) -> None:
        """Tell it nothing more; closing it is its owner's."""
        self._outlets.remove(outlet)
        self.health.left(outlet.part, outlet.name)
        self._dropped += outlet.dropped

    @property
    def dropped(self) -> int:
        """What the sinks of a live run could not do in time."""
        return self._dropped + sum(outlet.dropped for outlet in self._outlets)

    def found(self, frame: StereoFrame, detections: Sequence[Detection]) -> None:
        """What the detector answered for a frame."""
        if self._finder is None:
            return
        now_ns = self._source.now_ns
        if self._finder.error:
            self.health.done(Part.DETECTOR, now_ns, self._finder.took_s, (State.OFF, self._finder.error))
            return
        self.health.found(frame, detections, now_ns, self._finder.took_s, self._expected_px(frame))

    def solved(self, solution: Solution) -> None:
        self._last = solution
        self.health.solved(solution, self._source.now_ns)
        self.tell()

    def tell(self) -> None:
        """To the sinks: what has changed, and all of it once a second."""
        for outlet in self._outlets:
            outlet.collect()
        now_ns, conditions = self._source.now_ns, self.health.conditions
        if conditions is self._told[0] and now_ns - self._told[1] < TOLD_EVERY_S * NS_PER_S:
            return
        self._told = conditions, now_ns
        for outlet in self._outlets:
            outlet.health(conditions, now_ns)

    def _expected_px(self, frame: StereoFrame) -> tuple[float, float] | None:
        """Where the target is in the left image, if it is so well in view that a detector must see it."""
        last = self._last
        if last is None or last.position_m is None or last.range_m is None or last.status is not Status.VALID:
            return None
        if not DETECTED_WITHIN_M[0] < last.range_m < DETECTED_WITHIN_M[1]:
            return None
        x, y = self._rig.project(last.position_m[None])[0][0]
        height, width = frame.left.shape[:2]
        inside = IN_VIEW * width < x < (1 - IN_VIEW) * width and IN_VIEW * height < y < (1 - IN_VIEW) * height
        return (float(x), float(y)) if inside and np.isfinite(x + y) else None
