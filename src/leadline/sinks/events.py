"""``events.csv``: marks and what was recorded when. There is none where there was no event."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from leadline.health import Part
from leadline.samples import Detection, Sample, Solution, StereoFrame
from leadline.sinks.control import Event
from leadline.wire.spool import Spool
from leadline.wire.stamps import format_stamp
from leadline.wire.table import rows_text

HEADER = ("t_s", "text")


class EventsCsv:
    """Each row is on its way to the disk when ``event`` returns; while that has no room, OSError: rows wait."""

    part: ClassVar[Part] = Part.DISK

    def __init__(self, path: Path) -> None:
        self._path, self.name = path, path.name
        self._spool: Spool | None = None

    def sample(self, sample: Sample) -> None:
        """Nothing."""

    def detections(self, frame: StereoFrame, detections: Sequence[Detection]) -> None:
        """Nothing."""

    def solution(self, solution: Solution) -> None:
        """Nothing."""

    def event(self, event: Event) -> None:
        rows = [(format_stamp(event.t_ns), event.text)]
        if self._spool is None:
            self._spool, rows = Spool(self._path), [HEADER, *rows]
        self._spool.append(rows_text(rows).encode())

    def close(self) -> None:
        if self._spool is not None:
            self._spool.close()
