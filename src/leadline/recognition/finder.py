"""What a localizer asks of recognition."""

from __future__ import annotations

from typing import Protocol

from leadline.samples import Detection, StereoFrame


class Finder(Protocol):
    """What tells where in the left image the target is: a detector, boxes from a file, the whole view."""

    def find(self, frame: StereoFrame) -> list[Detection]: ...
