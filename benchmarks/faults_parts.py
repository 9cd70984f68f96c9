"""Parts that fail on purpose: detector, disk, output, the computer's clock. See ``leadline.simulation.faults``."""

from __future__ import annotations

import errno
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.faults_dive import Clock, Footage, shown
from leadline.health import Part, State, Verdict
from leadline.recognition.finder import Finder
from leadline.samples import Detection, Kind, Sample, Solution, Stage, Status, StereoFrame
from leadline.simulation.faults import Mode

USUAL_S, SLOW_S, LATE_S, SHARE = 0.02, 0.3, 0.5, 0.5


@dataclass(frozen=True, slots=True)
class Window:
    """A fault of ``part`` within [start_s, end_s) of the dive's time."""

    part: Part
    mode: Mode
    start_s: float
    end_s: float

    def mode_of(self, part: Part, now_s: float) -> Mode | None:
        return self.mode if part is self.part and self.start_s <= now_s < self.end_s else None


class FailingDetector:
    """True boxes with a pixel of noise."""

    def __init__(self, film: Footage, window: Window, clock: Clock, seed: int) -> None:
        self._film, self._window, self._clock = film, window, clock
        self._rng = np.random.default_rng(seed)
        self._said: list[tuple[float, list[Detection]]] = []
        self.first_s: float | None = None  # when it failed first

    def find(self, frame: StereoFrame) -> list[Detection]:
        mode = self._window.mode_of(Part.DETECTOR, frame.t_s)
        if mode == "intermittent" and self._rng.random() > SHARE:
            mode = None
        self.first_s = frame.t_s if mode and self.first_s is None else self.first_s
        self._clock.worked_s += SLOW_S if mode == "slow" else USUAL_S
        found = self._look(frame)
        if mode != "stuck":
            self._said = [*self._said[-20:], (frame.t_s, found)]
        match mode:
            case "off":
                raise RuntimeError("the model gives no answer")
            case "stuck":
                return self._said[-1][1]
            case "garbage":
                return [Detection(tuple(self._rng.uniform(-3e3, 3e3, 4)), 0.9)]
            case "wrong":
                return [Detection((one.box_px[0] + 1.7 * one.box_px[2], *one.box_px[1:]), 0.9) for one in found]
            case "delayed":
                return next((said for t_s, said in self._said if t_s >= frame.t_s - LATE_S), found)
            case "intermittent":
                return []
        return found

    def _look(self, frame: StereoFrame) -> list[Detection]:
        box = shown(frame, self._film)
        if box is None:
            return []
        x, y, width, height = (side + self._rng.normal(0, 0.5) for side in box)
        return [Detection((x, y, width, height), 0.9)]


class Told:
    """A localizer that is told the truth."""

    def __init__(self, film: Footage, finder: Finder) -> None:
        self._film, self._finder = film, finder
        self.detections: list[Detection] = []
        self.notices: list[str] = []

    def step(self, sample: Sample) -> Solution | None:
        if isinstance(sample, StereoFrame):
            self.detections = self._finder.find(sample)
        truth = self._film.truth.get(sample.t_ns)
        if truth is None:
            return None
        position_m, used = np.array(truth.position_m), (Kind.STEREO, Kind.LASER)
        cov_m2 = 1e-4 * np.eye(3)
        return Solution(sample.t_ns, Stage.BOTH, Status.VALID, position_m, cov_m2, truth.range_m, 0.01, used=used)


class FailingSink:
    """Keeps each solution, and what arrived of it, which it looks at afterwards as a reader of the file would."""

    def __init__(self, part: Part, window: Window, clock: Clock, seed: int) -> None:
        self.part, self.clock = part, clock
        self._window, self._rng = window, np.random.default_rng(seed)
        self._given: list[float] = []
        self._arrived: list[float] = []
        self.released = threading.Event()
        self.first_s: float | None = None  # when it failed first

    def sample(self, sample: Sample) -> None:
        """Only solutions are kept."""

    def detections(self, frame: StereoFrame, detections: Sequence[Detection]) -> None:
        """Only solutions are kept."""

    def solution(self, solution: Solution) -> None:
        mode = self._window.mode_of(self.part, solution.t_s)
        if mode == "intermittent" and self._rng.random() > SHARE:
            mode = None
        self.first_s = solution.t_s if mode and self.first_s is None else self.first_s
        self.clock.worked_s += SLOW_S if mode == "slow" else USUAL_S / 10
        said = solution.t_s + (solution.range_m or 0.0)
        if mode in ("off", "intermittent"):
            raise OSError(errno.ENOSPC, "no space left")
        if mode == "stuck":
            self.released.wait(60.0)
        self._given = [*self._given[-20:], said]
        arrives = {"garbage": float(self._rng.normal()), "wrong": said + 0.3, "delayed": self._given[0]}
        self._arrived = [*self._arrived[-20:], arrives.get(mode or "", said)]

    def check(self) -> Verdict:
        if self._arrived[-1] == self._given[-1]:
            return None
        if self._arrived[-1] in self._given:
            return State.DELAYED, "what arrives is old"
        near = abs(self._arrived[-1] - self._given[-1]) < 0.5
        return (State.WRONG if near else State.GARBAGE), "something else has arrived than was given"

    def close(self) -> None:
        self.released.set()


def failing_clock(window: Window, seed: int) -> Callable[[float], float]:
    """The computer's clock, s, at a time of the dive."""
    rng = np.random.default_rng(seed)

    def wall_s(now_s: float) -> float:
        mode = window.mode_of(Part.CLOCK, now_s)
        bent = {
            "off": now_s * 1e-9,  # 1970: no battery, and it does not run
            "stuck": window.start_s,
            "garbage": now_s + float(rng.normal(0, 30)),
            "wrong": now_s + 2.0,
            "slow": now_s - 0.3 * (now_s - window.start_s),
            "delayed": now_s - LATE_S,
            "intermittent": now_s + (5.0 if rng.random() < SHARE else 0.0),
        }
        return now_s if mode is None else bent[mode]

    return wall_s
