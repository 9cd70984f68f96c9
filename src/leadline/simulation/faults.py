"""Sensors that fail, as a filter on a stream of samples: what a real one does on a bad day.

| mode | within its window |
|---|---|
| off | nothing comes (of one camera alone: a black image) |
| stuck | the last value before it comes again and again, with fresh stamps |
| garbage | noise: random pixels, random ranges |
| wrong | plausible and false: ranges off by ``size`` metres, one image ``size`` pixels aside of the other |
| slow | only every ``size``-th sample comes |
| delayed | samples arrive ``size`` seconds later |
| intermittent | each sample is lost with probability ``size`` |
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, model_validator

from leadline.samples import NS_PER_S, Image, LaserRange, Sample, StereoFrame, VehicleMotion

Mode = Literal["off", "stuck", "garbage", "wrong", "slow", "delayed", "intermittent"]
Sensor = Literal["camera", "left", "right", "laser"]
_SIZES = {"wrong": 12.0, "slow": 4.0, "delayed": 0.5, "intermittent": 0.5}
_WRONG_RANGE_M = 0.3


class Fault(BaseModel):
    """One sensor's fault from ``start_s`` to ``end_s`` (None: to the end) of the dive's time stamps."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    sensor: Sensor
    mode: Mode
    start_s: float = 0.0
    end_s: float | None = None
    size: float | None = None  # what it means, and its default, depends on the mode

    @model_validator(mode="after")
    def _fits(self) -> Fault:
        if self.end_s is not None and self.end_s <= self.start_s:
            raise ValueError("end_s must be after start_s")
        if self.sensor in ("left", "right") and self.mode in ("slow", "delayed", "intermittent"):
            raise ValueError(f"{self.mode} is of the whole camera, not of its {self.sensor} half")
        if self.mode == "slow" and self.amount < 1:
            raise ValueError("size of slow must be 1 or more")
        return self

    @property
    def amount(self) -> float:
        if self.size is not None:
            return self.size
        return _WRONG_RANGE_M if (self.mode, self.sensor) == ("wrong", "laser") else _SIZES.get(self.mode, 0.0)

    def concerns(self, sample: Sample) -> bool:
        sensed = LaserRange if self.sensor == "laser" else StereoFrame
        within = self.start_s <= sample.t_s and (self.end_s is None or sample.t_s < self.end_s)
        return within and isinstance(sample, sensed)


def inject(samples: Iterable[Sample], faults: Sequence[Fault], rng: np.random.Generator) -> Iterator[Sample]:
    """The samples as they come with these faults, in the order of their new arrival times."""
    stream = iter(samples)
    for fault in faults:
        stream = _one(stream, fault, rng)
        if fault.mode == "delayed":
            stream = _by_arrival(stream, fault.amount)
    return stream


def _one(samples: Iterable[Sample], fault: Fault, rng: np.random.Generator) -> Iterator[Sample]:
    change = _Change(fault, rng)
    for sample in samples:
        changed = change(sample) if fault.concerns(sample) else sample
        if changed is sample:
            change.remember(sample)
        if changed is not None:
            yield changed


class _Change:
    """One fault's effect, and what it must remember."""

    def __init__(self, fault: Fault, rng: np.random.Generator) -> None:
        self._fault, self._rng = fault, rng
        self._last: Sample | None = None
        self._count = 0

    def remember(self, sample: Sample) -> None:
        if isinstance(sample, LaserRange if self._fault.sensor == "laser" else StereoFrame):
            self._last = sample

    def __call__(self, sample: Sample) -> Sample | None:
        fault = self._fault
        match fault.mode:
            case "slow":
                self._count += 1
                return sample if self._count % round(fault.amount) == 1 % round(fault.amount) else None
            case "intermittent":
                return None if self._rng.random() < fault.amount else sample
            case "delayed":
                arrival_ns = sample.t_ns if sample.arrival_ns is None else sample.arrival_ns
                return replace(sample, arrival_ns=arrival_ns + round(fault.amount * NS_PER_S))
        assert not isinstance(sample, VehicleMotion)  # no fault concerns it
        return self._range(sample) if isinstance(sample, LaserRange) else self._frame(sample)

    def _range(self, sample: LaserRange) -> LaserRange | None:
        match self._fault.mode:
            case "off":
                return None
            case "stuck":
                if self._last is None:
                    self._last = sample
                assert isinstance(self._last, LaserRange)
                return replace(sample, range_m=self._last.range_m, quality=self._last.quality)
            case "garbage":
                quality = None if sample.quality is None else float(self._rng.random())
                return replace(sample, range_m=round(float(self._rng.uniform(0, 10)), 3), quality=quality)
        return replace(sample, range_m=sample.range_m + self._fault.amount)

    def _frame(self, sample: StereoFrame) -> StereoFrame | None:
        if self._fault.mode == "off" and self._fault.sensor == "camera":
            return None
        if self._last is None:
            self._last = sample
        assert isinstance(self._last, StereoFrame)
        images = {"left": (sample.left, self._last.left), "right": (sample.right, self._last.right)}
        # Both images shifted alike would be a mere turn of the vehicle; one alone gives false depths.
        only = "right" if self._fault.mode == "wrong" and self._fault.sensor == "camera" else self._fault.sensor
        if only != "camera":
            images = {only: images[only]}
        spoil = self._spoiler()
        spoilt = {side: spoil(now, last) for side, (now, last) in images.items()}
        return replace(
            sample, left=spoilt.get("left", sample.left), right=spoilt.get("right", sample.right), encoded=None
        )

    def _spoiler(self) -> Callable[[Image, Image], Image]:
        match self._fault.mode:
            case "off":
                return lambda now, _: np.zeros_like(now)
            case "stuck":
                return lambda _, last: last
            case "garbage":
                return lambda now, _: self._rng.integers(0, 256, now.shape, np.uint8)
        return lambda now, _: np.roll(now, round(self._fault.amount), axis=1)


def _by_arrival(samples: Iterable[Sample], delay_s: float) -> Iterator[Sample]:
    """Sort a stream in which a sample comes at most ``delay_s`` before its arrival stamp."""
    waiting: list[tuple[int, int, Sample]] = []
    for number, sample in enumerate(samples):
        arrival_ns = sample.t_ns if sample.arrival_ns is None else sample.arrival_ns
        heapq.heappush(waiting, (arrival_ns, number, sample))
        while waiting and waiting[0][0] <= arrival_ns - round(delay_s * NS_PER_S):
            yield heapq.heappop(waiting)[2]
    while waiting:
        yield heapq.heappop(waiting)[2]
