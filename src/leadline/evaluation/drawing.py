"""Drawing on images: boxes with their label and score."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from leadline.samples import Detection, Image

COLOUR_BGR = (60, 60, 255)
INK_BGR = (255, 255, 255)


def draw_detections(image: Image, detections: Sequence[Detection]) -> Image:
    """A copy of ``image`` in colour with every detection's box, label and score."""
    canvas = image.copy() if image.ndim == 3 else np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)
    height, width = canvas.shape[:2]
    thick = max(1, round(max(height, width) / 500))
    for detection in detections:
        x, y, w, h = detection.box_px
        x0, y0 = max(round(x), 0), max(round(y), 0)
        x1, y1 = min(round(x + w), width - 1), min(round(y + h), height - 1)
        cv2.rectangle(canvas, (x0, y0), (x1, y1), COLOUR_BGR, thick)
        _label(canvas, f"{detection.label} {detection.score:.2f}", x0, y0, thick)
    return canvas


def _label(canvas: Image, text: str, x: int, y: int, thick: int) -> None:
    """Text on a filled bar above the box, or inside it where the box begins at the image's border."""
    scale = 0.4 * thick + 0.1
    (width, height), below = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, thick)
    bar = height + below + 2
    top = y - bar if y >= bar else y
    x = max(0, min(x, canvas.shape[1] - width))
    cv2.rectangle(canvas, (x, top), (x + width, top + bar), COLOUR_BGR, -1)
    cv2.putText(canvas, text, (x, top + height + 1), cv2.FONT_HERSHEY_SIMPLEX, scale, INK_BGR, thick, cv2.LINE_AA)
