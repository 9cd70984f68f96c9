"""``solutions.csv``, written row by row as the run goes."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from leadline.health import Part
from leadline.samples import Detection, Sample, Solution, StereoFrame
from leadline.wire.solutions import HEADER, solution_row


class SolutionsCsv:
    """Each row is on its way to the disk when ``solution`` returns: a killed run keeps what it had."""

    part: ClassVar[Part] = Part.DISK

    def __init__(self, path: Path | str) -> None:
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("w", encoding="utf-8", newline="")
        self._writer = csv.writer(self._file, lineterminator="\n")
        self._write(HEADER)

    def sample(self, sample: Sample) -> None:
        """Nothing: the table holds solutions."""

    def detections(self, frame: StereoFrame, detections: Sequence[Detection]) -> None:
        """Nothing: the table holds solutions."""

    def solution(self, solution: Solution) -> None:
        self._write(solution_row(solution))

    def close(self) -> None:
        self._file.close()

    def _write(self, cells: Sequence[str]) -> None:
        self._writer.writerow(cells)
        self._file.flush()
