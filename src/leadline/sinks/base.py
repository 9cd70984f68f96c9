"""Where a run goes. The recorder, the tables and the live displays all have this one shape."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from leadline.health import Condition, Verdict
from leadline.samples import Detection, Sample, Solution, StereoFrame
from leadline.sinks.control import Event


class Sink(Protocol):
    """A sink may say in an attribute ``part`` whose health its own work is; without it, that of the output. And in
    ``name`` what its user knows it by.
    """

    def sample(self, sample: Sample) -> None:
        """Every sample, before the localizer sees it."""

    def detections(self, frame: StereoFrame, detections: Sequence[Detection]) -> None:
        """What the detector found in the frame's left image (none: an empty sequence)."""

    def solution(self, solution: Solution) -> None:
        """The solution that followed the last sample."""

    def close(self) -> None:
        """Finish the file; safe to call twice."""


@runtime_checkable
class HealthSink(Protocol):
    """A sink that also takes the health of all parts."""

    def health(self, conditions: Sequence[Condition], now_ns: int) -> None:
        """Whenever one has changed and once a second, even while no sample comes (live)."""


@runtime_checkable
class EventSink(Protocol):
    """A sink that also keeps what somebody marked."""

    def event(self, event: Event) -> None:
        """Between two samples."""


@runtime_checkable
class CheckedSink(Protocol):
    """A sink that looks whether its work has arrived."""

    def check(self) -> Verdict:
        """After each solution; None where all is well."""
