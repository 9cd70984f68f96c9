"""Which of several boxes is the target, from frame to frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from leadline.config import TrackConfig
from leadline.samples import NS_PER_S, Detection

Box = tuple[float, float, float, float]
Pixel = tuple[float, float]
FAIR = 0.6  # a first choice scores at least this part of the best one
SIGMAS = 3.0


@dataclass(frozen=True, slots=True)
class Expected:
    """Where the target's outline should be now, in the image, and how far off its middle may be."""

    box: Box
    sigma_px: float


class Track:
    """One target's box. ``held``: no detection stands behind the last one."""

    def __init__(self, config: TrackConfig) -> None:
        self._config = config
        self.forget()

    def forget(self) -> None:
        self._box: Box | None = None
        self._seen_ns = 0
        self.held = False

    def follow(
        self, t_ns: int, detections: Sequence[Detection], expected: Expected | None, hit_px: Pixel | None = None
    ) -> Box | None:
        """The target's box in the image at ``t_ns``, or None where there is none to be looked at.

        What goes on from where the target is ``expected``, else from its last box; where nothing does, for ``hold_s``
        the place itself: a detector misses a target now and then, and another one in the picture is not it. Then, and
        at first, a new choice: what the beam hits (``hit_px``), else the surest and largest.
        """
        found = self._going_on(detections, expected)
        if found is None and self._box is not None and t_ns - self._seen_ns <= self._config.hold_s * NS_PER_S:
            self.held = True
            place = expected.box if expected is not None else self._box
            return place if place[2] > 0 and place[3] > 0 else None
        found = found or hit(detections, hit_px) or choose(detections)
        self.held = False
        if found is not None:
            self._box, self._seen_ns = found.box_px, t_ns
        return None if found is None else found.box_px

    def confirm(self, t_ns: int) -> None:
        """The target itself was measured in the box: as good as a detection."""
        self._seen_ns = max(t_ns, self._seen_ns)

    def _going_on(self, detections: Sequence[Detection], expected: Expected | None) -> Detection | None:
        if expected is not None:
            slack_px = SIGMAS * expected.sigma_px
            near = [d for d in detections if _apart(d.box_px, expected.box) <= self._reach_px(expected.box) + slack_px]
            if near:
                return nearest(near, expected.box)
        if self._box is None:
            return None
        near = [d for d in detections if _apart(d.box_px, self._box) <= self._reach_px(self._box)]
        return nearest(near, self._box) if near else None

    def _reach_px(self, box: Box) -> float:
        return max(self._config.reach * _size(box), self._config.least_reach_px)


def nearest(detections: Sequence[Detection], box: Box) -> Detection:
    """The one with the largest overlap, then the nearest middle."""
    return max(detections, key=lambda d: (iou(d.box_px, box), -_apart(d.box_px, box)))


def hit(detections: Sequence[Detection], hit_px: Pixel | None) -> Detection | None:
    """The surest of those around a pixel."""
    if hit_px is None:
        return None
    around = [d for d in detections if all(0 <= hit_px[k] - d.box_px[k] <= d.box_px[k + 2] for k in (0, 1))]
    return max(around, key=lambda d: d.score, default=None)


def choose(detections: Sequence[Detection]) -> Detection | None:
    """Of the surest the largest (score times area); None only without any detection."""
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


def _apart(a: Box, b: Box) -> float:
    """Distance of the middles, px."""
    dx, dy = a[0] + a[2] / 2 - b[0] - b[2] / 2, a[1] + a[3] / 2 - b[1] - b[3] / 2
    return float((dx * dx + dy * dy) ** 0.5)


def _size(box: Box) -> float:
    return float((box[2] * box[3]) ** 0.5)
