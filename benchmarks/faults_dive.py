"""A small simulated dive for ``benchmarks.faults``: rendered once, in the time of a clock that nobody waits for."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from leadline.rig import Rig
from leadline.samples import NS_PER_S, LaserRange, Sample, StereoFrame, Truth
from leadline.simulation.dive import SimulatedDive
from leadline.simulation.faults import Fault, inject
from leadline.simulation.scenario import Scenario
from leadline.sources import Source

Box = tuple[float, float, float, float]
DROPOUTS = 0.02
TICK_S, WALL_S = 0.1, 0.1
DIAMETER_M = 0.34
SECONDS = 17.0


@dataclass(frozen=True, slots=True, eq=False)
class Footage:
    """A dive's samples without any fault, the true boxes (x, y, width, height) by a frame's name, and the truth."""

    rig: Rig
    samples: tuple[Sample, ...]
    boxes_px: dict[str, Box]
    truth: dict[int, Truth]


def footage(kept: Path | None = None, seed: int = 3) -> Footage:
    """A ball from 2.1 m to 0.9 m, 320 x 180, 10 pairs and 3 readings a second. kept: a file that saves rendering it."""
    if kept is not None and kept.is_file():
        found: Footage = pickle.loads(kept.read_bytes())
        return found
    scenario = Scenario.load("demo")
    path = scenario.path.model_copy(update={"start_m": 2.1, "end_m": 0.9, "speed_m_s": 1.2 / SECONDS, "dwell_s": 0.0})
    camera = scenario.camera.model_copy(update={"image_width_px": 320, "rate_hz": 10.0})
    laser = scenario.laser.model_copy(update={"dropouts": 0.0})
    dive = SimulatedDive(scenario.model_copy(update={"path": path, "camera": camera, "laser": laser}), seed=seed)
    samples = tuple(dive.samples())
    boxes = {}
    for frame in dive.details["frames"]:
        x0, y0, x1, y1 = frame["box_left_px"] or (0, 0, 0, 0)
        if x1 > x0:
            boxes[frame["name"]] = (float(x0), float(y0), float(x1 - x0), float(y1 - y0))
    made = Footage(dive.rig, samples, boxes, {truth.t_ns: truth for truth in dive.truth})
    if kept is not None:
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_bytes(pickle.dumps(made))
    return made


class Clock:
    """Seconds of the dive; whoever works in it says how long it took."""

    def __init__(self) -> None:
        self.worked_s = 0.0

    def __call__(self) -> float:
        return self.worked_s


class LiveFootage(Source):
    """The samples as devices give them, in simulated time: faults, ticks while nothing comes, the wall clock."""

    live = True

    def __init__(
        self, film: Footage, seed: int, faults: list[Fault], wall_s: Callable[[float], float] = lambda now_s: now_s
    ) -> None:
        super().__init__("footage")
        self._film, self._seed, self._faults, self._wall_s = film, seed, faults, wall_s
        self._came: list[Sample] = []
        self._given: set[int] = set()

    def read(self) -> Iterator[Sample]:
        rng = np.random.default_rng(self._seed)
        whole = (one for one in self._film.samples if not isinstance(one, LaserRange) or rng.random() > DROPOUTS)
        self._came, self._given = [], set()
        ticked_ns = 0
        for sample in inject(self._noted(whole), self._faults, np.random.default_rng(self._seed + 1)):
            arrival_ns = sample.t_ns if sample.arrival_ns is None else sample.arrival_ns
            while ticked_ns and arrival_ns - ticked_ns > TICK_S * NS_PER_S:
                ticked_ns += round(TICK_S * NS_PER_S)
                self._pass(ticked_ns, idle=True)
            ticked_ns = arrival_ns
            self._pass(arrival_ns, idle=False)
            self._given.add(id(sample))
            yield sample

    def first_spoilt_s(self) -> float | None:
        """When the first sample was taken that was lost or changed."""
        return next((one.t_s for one in self._came if id(one) not in self._given), None)

    def _noted(self, samples: Iterable[Sample]) -> Iterator[Sample]:
        for one in samples:
            self._came.append(one)
            yield one

    def _pass(self, now_ns: int, *, idle: bool) -> None:
        assert self.health is not None
        if now_ns // round(WALL_S * NS_PER_S) != self._now_ns // round(WALL_S * NS_PER_S):
            self.health.wall_clock(round(self._wall_s(now_ns / NS_PER_S) * NS_PER_S), now_ns)
        self._now_ns = max(self._now_ns, now_ns)
        if idle:
            self.health.tick(now_ns)
            if self.idle is not None:
                self.idle()


def shown(frame: StereoFrame, film: Footage) -> Box | None:
    """The true box in what the left camera shows."""
    return film.boxes_px.get(frame.name) if frame.left.any() else None
