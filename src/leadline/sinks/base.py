"""Where a run goes. The recorder, the tables and the live displays all have this one shape."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from leadline.samples import Detection, Sample, Solution, StereoFrame


class Sink(Protocol):
    def sample(self, sample: Sample) -> None:
        """Every sample, before the localizer sees it."""

    def detections(self, frame: StereoFrame, detections: Sequence[Detection]) -> None:
        """What the detector found in the frame's left image (none: an empty sequence)."""

    def solution(self, solution: Solution) -> None:
        """The solution that followed the last sample."""

    def close(self) -> None:
        """Finish the file; safe to call twice."""
