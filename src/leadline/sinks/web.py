"""What the live page is told: the loop leaves it here as it comes, the page's server takes what is new in its own time.

The loop never waits: it only keeps references, and whoever is slow misses pictures, not the other way round.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from threading import Lock
from typing import Any

import numpy as np

from leadline.guidance import Guide
from leadline.health import Condition
from leadline.rig import Rig
from leadline.samples import NS_PER_S, Array, Detection, LaserRange, Sample, Solution, Stage, Status, StereoFrame, Truth
from leadline.sinks.control import Control, Event
from leadline.sinks.web_page import EVENTS_KEPT, History, Seen
from leadline.sinks.web_scene import Picture, beam, number, numbers, overlay, view
from leadline.target import Target

TRUTH_NEAR_NS = NS_PER_S // 5
LEAST_STEP_NS = 30_000_000  # between two rows of one kind
STATUSES = [status.value for status in Status]


class WebSink:
    """``Sink``, ``HealthSink`` and ``EventSink``; as ``Shown`` it is asked by the server's thread."""

    page = "index.html"
    name = "the live page"

    def __init__(
        self, name: str, rig: Rig, target: Target, guide: Guide, control: Control, truth: Sequence[Truth] = ()
    ) -> None:
        self.rig, self.target, self.control = rig, target, control
        self._name, self._guide = name, guide
        self._lock = Lock()
        self._run = time.time_ns()  # tells a page whether this is still the run that it shows
        self._rows, self._readings, self._events = History(), History(), History(EVENTS_KEPT)
        self._truth_ns = np.array([one.t_ns for one in truth], dtype=np.int64)
        self._truth_m = [one.range_m for one in truth]
        self._first_ns: int | None = None
        self._kept_ns = {"rows": -NS_PER_S, "readings": -NS_PER_S}
        self._frames = self._version = 0
        self._pending: tuple[StereoFrame, tuple[Detection, ...]] | None = None
        self._reading: LaserRange | None = None
        self.picture: Picture | None = None
        self._solution: Solution | None = None
        self._health: tuple[tuple[Condition, ...], int] = (), 0
        self._heard_s = time.monotonic()
        self._ended: list[str] | None = None

    # -- the loop's side ---------------------------------------------------------------------------------------------

    def sample(self, sample: Sample) -> None:
        with self._lock:
            self._heard_s = time.monotonic()
            self._first_ns = sample.t_ns if self._first_ns is None else self._first_ns
            self._version += 1
            if isinstance(sample, LaserRange):
                self._reading = sample
                self._note_reading(sample)

    def detections(self, frame: StereoFrame, detections: Sequence[Detection]) -> None:
        self._pending = frame, tuple(detections)

    def solution(self, solution: Solution) -> None:
        with self._lock:
            self._solution = solution
            self._version += 1
            if self._due("rows", solution.t_ns):
                self._rows.add(_row(solution, self._t_s(solution.t_ns), self._true_m(solution.t_ns)))
            if self._pending is not None and self._pending[0].t_ns == solution.t_ns:
                self._frames += 1
                self.picture = Picture(self._frames, *self._pending, solution, self._reading)
                self._pending = None

    def health(self, conditions: Sequence[Condition], now_ns: int) -> None:
        with self._lock:
            self._health = tuple(conditions), now_ns
            self._version += 1

    def event(self, event: Event) -> None:
        with self._lock:
            self._events.add([self._t_s(event.t_ns), event.text])
            self._version += 1

    def close(self) -> None:
        """The dive has ended; the page goes on showing it."""
        self.ended([])

    def ended(self, words: Sequence[str]) -> None:
        """What it came to, in lines."""
        with self._lock:
            self._ended = list(words)
            self._version += 1

    # -- the server's side -------------------------------------------------------------------------------------------

    def hello(self) -> dict[str, Any]:
        """What does not change during a run."""
        left, laser, config = self.rig.left, self.rig.laser, self._guide.config
        return {
            "kind": "hello",
            "run": str(self._run),
            "name": self._name,
            "target": self.target.name,
            "size": [left.width, left.height],
            "beam": beam(self.rig),
            "laser": None if laser is None else [numbers(laser.origin_m), numbers(laser.direction)],
            "view": view(self.rig),
            "right_m": numbers(self.rig.T_left_right.t_m),
            "limits": config.model_dump(),
            "stages": [stage.name.lower() for stage in Stage],
            "statuses": STATUSES,
        }

    def news(self, seen: Seen) -> dict[str, Any] | None:
        """What is new since ``seen``, which is brought up to date; None where nothing is."""
        with self._lock:
            if seen.version == self._version:
                return None
            told: dict[str, Any] = {
                "kind": "news",
                "rows": self._rows.since(seen.rows),
                "readings": self._readings.since(seen.readings),
                "events": self._events.since(seen.events),
            }
            seen.rows, seen.readings, seen.events = self._rows.count, self._readings.count, self._events.count
            seen.version = self._version
            solution, (conditions, now_ns), ended = self._solution, self._health, self._ended
            told["frames"] = self._frames
        told["guidance"] = self._guidance(solution)
        told["health"] = [_told(one, now_ns) for one in conditions]
        told["ended"] = ended
        desk = self.control.desk
        told["desk"] = {"recording": desk.files[-1].name if desk.recording else "", "trouble": desk.trouble}
        return told

    def scene(self, picture: Picture) -> dict[str, Any]:
        """What to draw over a picture."""
        return overlay(self.rig, self.target, picture)

    @property
    def silent_s(self) -> float:
        """How long no sample has come, seconds of the computer's time; 0 when the dive has ended."""
        return 0.0 if self._ended is not None else time.monotonic() - self._heard_s

    def _t_s(self, t_ns: int) -> float:
        return round((t_ns - (t_ns if self._first_ns is None else self._first_ns)) / NS_PER_S, 4)

    def _true_m(self, t_ns: int) -> float | None:
        """The range that really was (simulations), of the nearest stamp; None where nobody knows it."""
        if not self._truth_m:
            return None
        after = min(int(np.searchsorted(self._truth_ns, t_ns)), len(self._truth_m) - 1)
        before = max(after - 1, 0)
        nearest = min((before, after), key=lambda i: abs(int(self._truth_ns[i]) - t_ns))
        return self._truth_m[nearest] if abs(int(self._truth_ns[nearest]) - t_ns) < TRUTH_NEAR_NS else None

    def _due(self, kind: str, t_ns: int) -> bool:
        if abs(t_ns - self._kept_ns[kind]) < LEAST_STEP_NS:
            return False
        self._kept_ns[kind] = t_ns
        return True

    def _note_reading(self, reading: LaserRange) -> None:
        if self.rig.laser is None or not self._due("readings", reading.t_ns):
            return
        lit_m = float(np.linalg.norm(self.rig.laser.point_m(reading.range_m)))
        self._readings.add([self._t_s(reading.t_ns), number(lit_m)])

    def _guidance(self, solution: Solution | None) -> dict[str, Any] | None:
        guidance = None if solution is None else self._guide.of(solution)
        if guidance is None:
            return None
        return {
            "bearing_deg": number(math.degrees(guidance.bearing_rad), 2),
            "elevation_deg": number(math.degrees(guidance.elevation_rad), 2),
            "closing_m_s": number(guidance.closing_m_s, 4),
            "standoff_s": number(guidance.standoff_s, 1),
            "alarm": guidance.alarm,
            "in_reach": guidance.in_reach,
            "accurate": guidance.accurate,
        }


def _row(solution: Solution, t_s: float, true_m: float | None) -> list[Any]:
    """t, stage, status, true range; unless lost also range, its sigma, position (3), covariance (xx xy xz yy yz zz)."""
    row: list[Any] = [t_s, int(solution.stage), STATUSES.index(solution.status), number(true_m)]
    if solution.position_m is None or solution.cov_m2 is None:
        return row
    upper: Array = solution.cov_m2[np.triu_indices(3)]
    return [
        *row,
        number(solution.range_m),
        number(solution.range_sigma_m),
        *numbers(solution.position_m),
        *(float(f"{one:.4g}") for one in upper),
    ]


def _told(condition: Condition, now_ns: int) -> dict[str, Any]:
    return {
        "part": condition.part,
        "state": condition.state,
        "why": condition.why,
        "advice": condition.advice,
        "since_s": number((now_ns - condition.since_ns) / NS_PER_S, 1),
    }
