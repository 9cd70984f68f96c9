"""A dive folder as a source."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

from leadline.errors import InputError
from leadline.rig import Rig
from leadline.samples import LaserRange, Sample, StereoFrame, VehicleMotion
from leadline.sources.base import Source, frame_size
from leadline.sources.sync import order_key
from leadline.wire.dive_folder import FrameEntry, read_frames, read_laser, read_motion
from leadline.wire.images import SizeError
from leadline.wire.notice import Notice, NoticeKind
from leadline.wire.truth import read_truth

_Entry = tuple[str, FrameEntry | LaserRange | VehicleMotion]


class FolderSource(Source):
    """Rows are put in arrival order (``t_arrival_s``, else ``t_s``); a row that stood out of it is told."""

    def __init__(self, folder: Path, *, real_time: bool = False) -> None:
        notices: list[Notice] = []
        frames: list[_Entry] = [(entry.where, entry) for entry in read_frames(folder, notices.append)]
        laser: list[_Entry] = list(read_laser(folder, notices.append))
        motion: list[_Entry] = list(read_motion(folder, notices.append))
        for rows in (frames, laser, motion):
            notices += _out_of_order(rows)
        self._entries = sorted(frames + laser + motion, key=_key)
        rig_path, truth_path = folder / "rig.yaml", folder / "truth.csv"
        super().__init__(
            str(folder),
            rig=Rig.load(rig_path) if rig_path.is_file() else None,
            truth=read_truth(truth_path, notices.append) if truth_path.is_file() else (),
            frame_count=len(frames),
            image_size=_first_size(self._entries),
            frame_names=[entry.name for _, entry in frames if isinstance(entry, FrameEntry)],
            notices=notices,
            real_time=real_time,
        )

    def read(self) -> Iterator[Sample]:
        for where, entry in self._entries:
            if not isinstance(entry, FrameEntry):
                yield entry
                continue
            try:
                frame = entry.load()
            except ValueError as error:
                self.tell(NoticeKind.SKIPPED, where, str(error))
                continue
            if self.fits(frame, where):
                yield frame


def _key(row: _Entry) -> tuple[int, int, int]:
    entry = row[1]
    arrival = entry.t_ns if entry.arrival_ns is None else entry.arrival_ns
    return order_key(arrival, StereoFrame if isinstance(entry, FrameEntry) else type(entry), entry.t_ns)


def _out_of_order(rows: list[_Entry]) -> list[Notice]:
    return [
        Notice(NoticeKind.REORDERED, after[0], "stands after a row that arrived later; taken in order of time")
        for before, after in pairwise(rows)
        if _key(after)[0] < _key(before)[0]
    ]


def _first_size(entries: list[_Entry]) -> tuple[int, int]:
    """The size of the first frame that can be read. InputError if its images differ in size, or none can be read."""
    problem = ""
    for where, entry in entries:
        if not isinstance(entry, FrameEntry):
            continue
        try:
            return frame_size(entry.load())
        except SizeError as error:
            raise InputError(str(error), where, "give left and right images of one camera pair") from None
        except ValueError as error:
            problem = problem or f"{where}: {error}"
    raise InputError(f"no frame can be read ({problem})", fix="check the images")
