"""A source gives samples in the order in which they arrived; live, simulated and replayed dives differ only here."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, ClassVar

from leadline.errors import InputError
from leadline.samples import NS_PER_S, Sample, StereoFrame, Truth
from leadline.sources.sync import arrival_ns, watch_order
from leadline.wire.notice import Notice, NoticeKind, count_notices

if TYPE_CHECKING:
    from leadline.health import Health
    from leadline.rig import Rig

TOLD_AT_MOST = 10_000  # notices kept of one iteration: a live source may run for weeks; all are counted


class Source(ABC):
    """Iterate for samples in arrival order; iterating again replays the same samples.

    ``rig`` and ``truth`` come with the dive where it has them; ``frame_count`` is for progress (None: not known);
    ``image_size`` is (width, height) of the frames and ``frame_names`` their names, where known before the first one
    (None: not known). ``notices`` is complete when an
    iteration has ended; a new iteration starts its list again. ``health``, where it is set, is fed with every sample as
    it comes, before anything is left out, and by a ``live`` source with what it knows of its devices.
    """

    live: ClassVar[bool] = False  # devices: nothing can be read twice, and there is no end

    def __init__(
        self,
        name: str,
        *,
        rig: Rig | None = None,
        truth: Sequence[Truth] = (),
        frame_count: int | None = None,
        image_size: tuple[int, int] | None = None,
        frame_names: Sequence[str] | None = None,
        notices: Sequence[Notice] = (),
        real_time: bool = False,
    ) -> None:
        self.name, self.rig, self.truth = name, rig, list(truth)
        self.frame_count, self.image_size, self.frame_names = frame_count, image_size, frame_names
        self._standing = list(notices)  # found on opening: they hold for every iteration
        self._passing: list[Notice] = []
        self._counts: Counter[str] = Counter()
        self._real_time = real_time
        self.health: Health | None = None
        self.idle: Callable[[], None] | None = None  # called about ten times a second while nothing comes (live)
        self._now_ns = 0

    @abstractmethod
    def read(self) -> Iterator[Sample]:
        """The samples in arrival order, from the start; ``tell`` what had to be left out."""

    def close(self) -> None:  # noqa: B027  most have nothing to let go of
        """Let go of devices and files; safe to call twice."""

    @property
    def opened(self) -> bool:
        """Whether all that there is to open has been."""
        return True

    @property
    def now_ns(self) -> int:
        """The dive's own time: when the last sample arrived; later only while a live source has nothing to give."""
        return self._now_ns

    def tell(self, kind: NoticeKind, where: str, why: str) -> None:
        self.note(Notice(kind, where, why))

    def note(self, notice: Notice) -> None:
        self._counts[str(notice.kind)] += 1
        if len(self._passing) < TOLD_AT_MOST:
            self._passing.append(notice)

    def fits(self, frame: StereoFrame, where: str) -> bool:
        """Whether the frame has the size of the dive's first one; told if not."""
        if frame_size(frame) == self.image_size:
            return True
        width, height = frame_size(frame)
        self.tell(NoticeKind.SKIPPED, where, f"the images are {width}x{height}, unlike those of the first frame")
        return False

    @property
    def notices(self) -> list[Notice]:
        return self._standing + self._passing

    @property
    def notice_counts(self) -> dict[str, int]:
        """How many of each kind; empty on clean data."""
        return dict(Counter(count_notices(self._standing)) + self._counts)

    def __iter__(self) -> Iterator[Sample]:
        self._passing.clear()
        self._counts.clear()
        self._now_ns = 0
        samples = watch_order(self._watched(self.read()), self.tell)
        return _at_own_pace(samples) if self._real_time else samples

    def _watched(self, samples: Iterator[Sample]) -> Iterator[Sample]:
        for sample in samples:
            self._now_ns = max(self._now_ns, arrival_ns(sample))
            if self.health is not None:
                self.health.sample(sample)
            yield sample


def _at_own_pace(samples: Iterator[Sample]) -> Iterator[Sample]:
    """Hold each sample back until as much time has passed as between the arrivals of the first sample and of it."""
    start_s, first_ns = time.monotonic(), None
    for sample in samples:
        first_ns = arrival_ns(sample) if first_ns is None else first_ns
        due_s = start_s + (arrival_ns(sample) - first_ns) / NS_PER_S
        time.sleep(max(0.0, due_s - time.monotonic()))
        yield sample


def frame_size(frame: StereoFrame) -> tuple[int, int]:
    """(width, height) of the left image, px."""
    return frame.left.shape[1], frame.left.shape[0]


def require_size(rig: Rig, source: Source) -> None:
    """InputError where the images are not of the size that the rig was calibrated for (nothing known: no complaint)."""
    if source.image_size is None:
        return
    for side, camera in (("left", rig.left), ("right", rig.right)):
        if (camera.width, camera.height) != source.image_size:
            width, height = source.image_size
            raise InputError(
                f"images are {width}x{height}, the rig's {side} camera is {camera.width}x{camera.height}",
                source.name,
                "give the rig that was calibrated at this image size",
            )
