"""A source gives samples in the order in which they arrived; live, simulated and replayed dives differ only here."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from leadline.errors import InputError
from leadline.samples import NS_PER_S, Sample, StereoFrame, Truth
from leadline.sources.sync import arrival_ns, watch_order
from leadline.wire.notice import Notice, NoticeKind

if TYPE_CHECKING:
    from leadline.rig import Rig


class Source(ABC):
    """Iterate for samples in arrival order; iterating again replays the same samples.

    ``rig`` and ``truth`` come with the dive where it has them; ``frame_count`` is for progress (None: not known);
    ``image_size`` is (width, height) of the frames where known before the first one. ``notices`` is complete when an
    iteration has ended; a new iteration starts its list again.
    """

    def __init__(
        self,
        name: str,
        *,
        rig: Rig | None = None,
        truth: Sequence[Truth] = (),
        frame_count: int | None = None,
        image_size: tuple[int, int] | None = None,
        notices: Sequence[Notice] = (),
        real_time: bool = False,
    ) -> None:
        self.name, self.rig, self.truth = name, rig, list(truth)
        self.frame_count, self.image_size = frame_count, image_size
        self._standing = list(notices)  # found on opening: they hold for every iteration
        self._passing: list[Notice] = []
        self._real_time = real_time

    @abstractmethod
    def read(self) -> Iterator[Sample]:
        """The samples in arrival order, from the start; ``tell`` what had to be left out."""

    def tell(self, kind: NoticeKind, where: str, why: str) -> None:
        self._passing.append(Notice(kind, where, why))

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

    def __iter__(self) -> Iterator[Sample]:
        self._passing.clear()
        samples = watch_order(self.read(), self.tell)
        return _at_own_pace(samples) if self._real_time else samples


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
