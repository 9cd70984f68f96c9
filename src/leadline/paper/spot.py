"""The laser spot as in section 3.3.1: grey threshold, circularity, area; to a whole pixel."""

from __future__ import annotations

import cv2
import numpy as np

from leadline.samples import Image


def find_spots(
    grey: Image, threshold: float, least_circularity: float, area_px: tuple[float, float]
) -> list[tuple[int, int]]:
    """The pixels (u, v) at the centres of round blobs of a fitting size, the brightest first."""
    _, bright = cv2.threshold(grey, threshold, 255, cv2.THRESH_BINARY)
    outlines, _ = cv2.findContours(bright, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    found: list[tuple[float, tuple[int, int]]] = []
    for outline in outlines:
        x, y, width, height = cv2.boundingRect(outline)
        if width * height < area_px[0]:  # most are specks: spare them the rest
            continue
        blob = bright[y : y + height, x : x + width] > 0
        if not area_px[0] <= np.count_nonzero(blob) <= area_px[1] or _circularity(outline) < least_circularity:
            continue
        rows, columns = np.nonzero(blob)
        centre = x + round(float(columns.mean())), y + round(float(rows.mean()))
        found.append((float(grey[y : y + height, x : x + width][blob].mean()), centre))
    return [centre for _, centre in sorted(found, reverse=True)]


def _circularity(outline: cv2.typing.MatLike) -> float:
    """4 pi A / P^2: 1 for a circle."""
    around = cv2.arcLength(outline, closed=True)
    return 4 * np.pi * cv2.contourArea(outline) / around**2 if around > 0 else 0.0
