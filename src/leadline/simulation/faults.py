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

Of one camera of two, slow and intermittent are pairs that hold its last picture again, delayed are pairs that hold an
older one; ``left_t_ns`` and ``right_t_ns`` then tell, as drivers do, when each was taken.
"""

from __future__ import annotations

import heapq
from collections import deque
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
        if self.mode == "slow" and self.amount < 1:
            raise ValueError("size of slow must be 1 or more")
        return self

    @property
    def amount(self) -> float:
        if self.size is not None:
            return self.size
        return _WRONG_RANGE_M if (self.mode, self.sensor) == ("wrong", "laser") else _SIZES.get(self.mode, 0.0)

    @property
    def late_half(self) -> bool:
        """One camera of two gives older pictures than the other."""
        return self.mode == "delayed" and self.sensor in ("left", "right")

    def concerns(self, sample: Sample) -> bool:
        sensed = LaserRange if self.sensor == "laser" else StereoFrame
        within = self.start_s <= sample.t_s and (self.end_s is None or sample.t_s < self.end_s)
        return within and isinstance(sample, sensed)


def inject(samples: Iterable[Sample], faults: Sequence[Fault], rng: np.random.Generator) -> Iterator[Sample]:
    """The samples as they come with these faults, in the order of their new arrival times."""
    stream = iter(samples)
    for fault in faults:
        stream = _one(stream, fault, rng)
        if fault.mode == "delayed" and fault.sensor in ("camera", "laser"):
            stream = _by_arrival(stream, fault.amount)
    return stream


def _one(samples: Iterable[Sample], fault: Fault, rng: np.random.Generator) -> Iterator[Sample]:
    change = _Change(fault, rng)
    for sample in samples:
        if fault.late_half:
            change.remember(sample)
        changed = change(sample) if fault.concerns(sample) else sample
        if changed is sample and not fault.late_half:
            change.remember(sample)
        if changed is not None:
            yield changed


class _Change:
    """One fault's effect, and what it must remember."""

    def __init__(self, fault: Fault, rng: np.random.Generator) -> None:
        self._fault, self._rng = fault, rng
        self._last: Sample | None = None
        self._older: deque[StereoFrame] = deque()  # of the last ``amount`` seconds
        self._count = 0

    def remember(self, sample: Sample) -> None:
        if isinstance(sample, LaserRange if self._fault.sensor == "laser" else StereoFrame):
            self._last = sample
        if self._fault.late_half and isinstance(sample, StereoFrame):
            self._older.append(sample)
            while len(self._older) > 1 and self._older[1].t_ns <= sample.t_ns - self._fault.amount * NS_PER_S:
                self._older.popleft()

    def __call__(self, sample: Sample) -> Sample | None:
        fault = self._fault
        match fault.mode:
            case "slow" | "intermittent":
                self._count += 1
                return self._without(sample) if self._is_lost() else sample
            case "delayed":
                if fault.late_half:
                    assert isinstance(sample, StereoFrame)
                    return _half(sample, self._older[0] if self._older else sample, fault.sensor)
                arrival_ns = sample.t_ns if sample.arrival_ns is None else sample.arrival_ns
                return replace(sample, arrival_ns=arrival_ns + round(fault.amount * NS_PER_S))
        assert not isinstance(sample, VehicleMotion)  # no fault concerns it
        return self._range(sample) if isinstance(sample, LaserRange) else self._frame(sample)

    def _is_lost(self) -> bool:
        if self._fault.mode == "intermittent":
            return bool(self._rng.random() < self._fault.amount)
        return self._count % round(self._fault.amount) != 1 % round(self._fault.amount)

    def _without(self, sample: Sample) -> StereoFrame | None:
        """The pair with the last picture of the camera that gave no new one; nothing where it is the whole sensor."""
        if self._fault.sensor in ("camera", "laser") or not isinstance(self._last, StereoFrame):
            return None
        assert isinstance(sample, StereoFrame)
        return _half(sample, self._last, self._fault.sensor)

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


def _half(frame: StereoFrame, older: StereoFrame, side: Sensor) -> StereoFrame:
    """One picture of ``frame`` replaced by that of ``older``, with the time when it was taken."""
    left_ns, right_ns = (frame.t_ns if t_ns is None else t_ns for t_ns in (frame.left_t_ns, frame.right_t_ns))
    if side == "left":
        was_ns = older.t_ns if older.left_t_ns is None else older.left_t_ns
        return replace(frame, left=older.left, left_t_ns=was_ns, right_t_ns=right_ns, encoded=None)
    was_ns = older.t_ns if older.right_t_ns is None else older.right_t_ns
    return replace(frame, right=older.right, left_t_ns=left_ns, right_t_ns=was_ns, encoded=None)


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
