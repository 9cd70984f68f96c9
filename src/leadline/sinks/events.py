"""``events.csv``: marks and what was recorded when. There is none where there was no event."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, TextIO

from leadline.health import Part
from leadline.samples import Detection, Sample, Solution, StereoFrame
from leadline.sinks.control import Event
from leadline.wire.stamps import format_stamp

HEADER = ("t_s", "text")


class EventsCsv:
    """Each row is on its way to the disk when ``event`` returns."""

    part: ClassVar[Part] = Part.DISK

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: TextIO | None = None

    def sample(self, sample: Sample) -> None:
        """Nothing."""

    def detections(self, frame: StereoFrame, detections: Sequence[Detection]) -> None:
        """Nothing."""

    def solution(self, solution: Solution) -> None:
        """Nothing."""

    def event(self, event: Event) -> None:
        if self._file is None:
            self._file = self._path.open("w", encoding="utf-8", newline="")
            self._write(HEADER)
        self._write((format_stamp(event.t_ns), event.text))

    def close(self) -> None:
        if self._file is not None:
            self._file.close()

    def _write(self, cells: Sequence[str]) -> None:
        assert self._file is not None
        csv.writer(self._file, lineterminator="\n").writerow(cells)
        self._file.flush()
