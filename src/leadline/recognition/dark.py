"""The frame without the laser beside the one with it: what is left of the difference is the laser's own light."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from leadline.samples import Array, Image

Picture = NDArray[np.floating[Any] | np.integer[Any]]

MOVED_PX = 12  # farther, and what was hidden comes into view
REFINED = 3  # steps
OUTLIER = 3.0  # robust sigmas: the spot itself
HELPS = 0.7  # the difference must have at most this part of the picture's own variance, or texture is not what disturbs
MARGIN_PX = 48


def around(curve_px: Array, size: tuple[int, int]) -> tuple[slice, slice] | None:
    """Rows and columns of a picture of size (height, width) in which a curve (K, 2) lies, with a margin."""
    seen = curve_px[np.isfinite(curve_px).all(axis=1)]
    if len(seen) == 0:
        return None
    low = np.maximum(np.floor(seen.min(axis=0)).astype(int) - MARGIN_PX, 0)
    high = np.minimum(np.ceil(seen.max(axis=0)).astype(int) + MARGIN_PX, [size[1], size[0]])
    if (high - low < MARGIN_PX).any():
        return None
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def aligned(dark: Image, light: Image) -> Image | None:
    """``dark`` moved onto ``light`` (both the same part of a camera's picture); None where that takes nothing away.

    One shift for the whole part: of whole pixels by correlation, then by least squares in which the laser's spot does
    not count.
    """
    before, now = (np.asarray(image if image.ndim == 2 else image[..., 1], np.float32) for image in (dark, light))
    inside = np.s_[MOVED_PX:-MOVED_PX, MOVED_PX:-MOVED_PX]
    peak = cv2.minMaxLoc(cv2.matchTemplate(before, now[inside], cv2.TM_CCOEFF_NORMED))[3]
    shift = np.array([MOVED_PX - peak[0], MOVED_PX - peak[1]], float)
    for _ in range(REFINED):
        moved = _moved(before, shift)[inside]
        rest = np.asarray(now[inside] - moved, np.float64)
        rest -= np.median(rest)
        limit = OUTLIER * 1.4826 * float(np.median(np.abs(rest))) + 1e-3
        weight = np.abs(rest) < limit
        by_y, by_x = (np.asarray(part)[weight] for part in np.gradient(moved))
        terms = np.stack([by_x, by_y])
        shift -= np.linalg.lstsq(terms @ terms.T + np.eye(2), terms @ rest[weight], rcond=None)[0]
    if np.abs(shift).max() > MOVED_PX:
        return None
    moved_dark = _moved(dark, shift)
    left = now - np.asarray(moved_dark if moved_dark.ndim == 2 else moved_dark[..., 1], np.float32)
    if _spread(left) > HELPS**0.5 * _spread(now):
        return None
    return np.asarray(moved_dark, np.uint8)


def _moved(image: Picture, shift: Array) -> Picture:
    move = np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]])
    size = image.shape[1], image.shape[0]
    return np.asarray(cv2.warpAffine(image, move, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE))


def _spread(values: NDArray[np.floating[Any]]) -> float:
    """Of what changes from place to place, robustly: the spot is not to count."""
    fine = np.asarray(values - cv2.blur(values, (31, 31)))
    return float(np.median(np.abs(fine)))
