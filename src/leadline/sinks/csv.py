"""``solutions.csv``, written row by row as the run goes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from leadline.health import Part, State, Verdict
from leadline.samples import Detection, Sample, Solution, StereoFrame
from leadline.wire.solutions import HEADER, solution_row
from leadline.wire.spool import Spool
from leadline.wire.table import rows_text

KEPT_BYTES = 4 * 2**20  # rows that wait for room on a full disk: a quarter of an hour


class SolutionsCsv:
    """Each row is on its way to the disk when ``solution`` returns: a killed run keeps what it had.

    While the disk has no room, ``solution`` raises OSError and the rows wait.
    """

    part: ClassVar[Part] = Part.DISK

    def __init__(self, path: Path | str) -> None:
        self.name = Path(path).name
        self._spool = Spool(Path(path), keep_bytes=KEPT_BYTES)
        self._write(HEADER)

    def sample(self, sample: Sample) -> None:
        """Nothing: the table holds solutions."""

    def detections(self, frame: StereoFrame, detections: Sequence[Detection]) -> None:
        """Nothing: the table holds solutions."""

    def solution(self, solution: Solution) -> None:
        self._write(solution_row(solution))

    def check(self) -> Verdict:
        """Read the last row back: a file that somebody has removed or changed, a disk that loses or spoils data."""
        size, row = self._spool.written
        try:
            with self._spool.path.open("rb") as file:
                file.seek(size - len(row))
                found = file.read(len(row))
        except OSError as error:
            return State.OFF, f"{self._spool.path.name} cannot be read back ({error.strerror})"
        if found == row:
            return None
        name = self._spool.path.name
        if len(found) < len(row):
            return State.WRONG, f"{name} holds less than was written"
        return State.GARBAGE, f"{name} holds other than was written"

    def close(self) -> None:
        self._spool.close()

    def _write(self, cells: Sequence[str]) -> None:
        self._spool.append(rows_text([cells]).encode())
