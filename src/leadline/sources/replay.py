"""A recorded or simulated dive as a live device: its samples come when they came then, whether one is ready or not."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import ClassVar

from leadline.health import Part
from leadline.samples import NS_PER_S, Sample
from leadline.sources.base import Source
from leadline.sources.clock import LiveClock
from leadline.sources.inbox import Item
from leadline.sources.live import LiveSource
from leadline.sources.part import Finished, LivePart
from leadline.sources.sync import arrival_ns

SHORT_WAIT_S = 0.1
BEHIND_S = 0.1


class Replay(LivePart):
    """The dive's own time is now: stamps stay as they are."""

    parts: ClassVar[tuple[Part, ...]] = ()
    hang_s: ClassVar[float] = 60.0  # a picture may have to be rendered first

    def __init__(self, source: Source, clock: LiveClock) -> None:
        self.name = source.name
        self._source, self._clock = source, clock
        self._samples: Iterator[Sample] = iter(())
        self._next: Sample | None = None

    def open(self) -> None:
        self._samples = self._source.read()
        self._next = next(self._samples, None)
        if self._next is not None:
            self._clock.start_at(arrival_ns(self._next))

    def read(self) -> Sequence[Item]:
        sample = self._next
        if sample is None:
            raise Finished
        due_s = (arrival_ns(sample) - self._clock.now_ns()) / NS_PER_S
        time.sleep(min(max(due_s, 0.0), SHORT_WAIT_S))
        if due_s > SHORT_WAIT_S:
            return ()
        self._next = next(self._samples, None)
        if self._next is not None and self._clock.now_ns() - arrival_ns(self._next) > BEHIND_S * NS_PER_S:
            self._clock.start_at(arrival_ns(self._next))  # a renderer is slow: the dive's time has waited for it
        return (sample,)

    def close(self) -> None:
        self._samples = iter(())


def live_dive(source: Source) -> LiveSource:
    """The dive as devices would give it, with its rig and its truth."""
    clock = LiveClock(held=True)
    live = LiveSource(f"live:{source.name}", [lambda: Replay(source, clock)], clock)
    live.of, live.rig, live.truth = source, source.rig, source.truth
    live.image_size, live.frame_names = source.image_size, source.frame_names
    return live
