"""Image pairs of a calibration folder as a source: stills, each of them held for a while."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from leadline.errors import InputError
from leadline.samples import NS_PER_S, Sample, StereoFrame
from leadline.sources.base import Source, frame_size
from leadline.wire.calibration_folder import read_calibration_folder

APART_S = 2


class StillsSource(Source):
    """In order of their names, two seconds apart. InputError where the folder has no pairs."""

    def __init__(self, folder: Path, *, real_time: bool = False) -> None:
        found = read_calibration_folder(folder)
        if found.mono:
            raise InputError(
                "has one camera's images", str(folder), "give pairs: left* with right*, or left/ and right/"
            )
        self._pairs = found.pairs
        super().__init__(str(folder), frame_count=len(found.pairs), notices=found.notices, real_time=real_time)

    def read(self) -> Iterator[Sample]:
        for number, pair in enumerate(self._pairs):
            left, right = pair.load()
            assert right is not None
            frame = StereoFrame(number * APART_S * NS_PER_S, left, right, name=pair.name)
            self.image_size = self.image_size or frame_size(frame)
            if self.fits(frame, pair.name):
                yield frame
