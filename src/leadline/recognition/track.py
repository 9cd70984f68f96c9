"""Which of several boxes is the target."""

from __future__ import annotations

from collections.abc import Sequence

from leadline.samples import Detection

Box = tuple[float, float, float, float]
REACH = 1.0  # a target moves by at most about its own size between frames
FAIR = 0.6  # a first choice scores at least this part of the best one


def choose(detections: Sequence[Detection], last_box: Box | None = None) -> Detection | None:
    """The detection that continues ``last_box`` (x, y, w, h), else, of the surest, the largest (score times area).

    A box continues the last one when they overlap, or when its centre lies within ``REACH`` of the last box's size; of
    those the largest overlap counts, then the nearest centre. None only without any detection.
    """
    if last_box is not None:
        near = [d for d in detections if _distance(d.box_px, last_box) <= REACH]
        if near:
            return max(near, key=lambda d: (iou(d.box_px, last_box), -_distance(d.box_px, last_box)))
    best = max((d.score for d in detections), default=0.0)
    sure = [d for d in detections if d.score >= FAIR * best]
    return max(sure, key=lambda d: d.score * d.box_px[2] * d.box_px[3], default=None)


def iou(a: Box, b: Box) -> float:
    """Shared area over united area of two boxes x, y, w, h."""
    width = min(a[0] + a[2], b[0] + b[2]) - max(a[0], b[0])
    height = min(a[1] + a[3], b[1] + b[3]) - max(a[1], b[1])
    if width <= 0 or height <= 0:
        return 0.0
    return width * height / (a[2] * a[3] + b[2] * b[3] - width * height)


def _distance(a: Box, b: Box) -> float:
    """Distance of the centres, in sizes of ``b``, 0 where the boxes overlap by half."""
    if iou(a, b) >= 0.5:
        return 0.0
    dx, dy = a[0] + a[2] / 2 - b[0] - b[2] / 2, a[1] + a[3] / 2 - b[1] - b[3] / 2
    return float((dx * dx + dy * dy) ** 0.5 / max((b[2] * b[3]) ** 0.5, 1e-9))
