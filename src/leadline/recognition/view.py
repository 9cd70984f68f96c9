"""A target that is all there is to see: a hull or a pile in front of the camera needs no detector."""

from __future__ import annotations

from leadline.samples import Detection, StereoFrame


class WholeView:
    """Finds the whole left image."""

    def find(self, frame: StereoFrame) -> list[Detection]:
        height, width = frame.left.shape[:2]
        return [Detection((0.0, 0.0, float(width), float(height)), 1.0, "view")]
