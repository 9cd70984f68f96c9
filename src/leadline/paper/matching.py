"""Integer block matching along the row: no sub-pixel step, no check from right to left (the paper names neither)."""

from __future__ import annotations

import cv2
import numpy as np

from leadline.samples import Image

NEIGHBOURS = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))  # the point and its four neighbours, px (section 3.3.2)


def smooth(image: Image, sigma_px: float) -> Image:
    """Take the sensor's noise off an image (H, W) before it is matched."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px), dtype=np.uint8)


def match_block(
    left: Image,
    right: Image,
    centre_px: tuple[int, int],
    *,
    block_px: int,
    span_px: tuple[int, int],
    least_score: float,
) -> int | None:
    """The disparity (whole px) of the block around a pixel of the rectified left image; None where it cannot be said.

    left, right: (H, W) grey, rectified; span: least and greatest disparity. The best normalised cross-correlation on
    the same row wins; below ``least_score``, or with a block that leaves the image, there is none.
    """
    u, v = centre_px
    half = block_px // 2
    height, width = left.shape
    first, last = max(u - span_px[1] - half, 0), u - span_px[0] + half
    if not (half <= u < width - half and half <= v < height - half) or last - first < 2 * half:
        return None
    rows = slice(v - half, v + half + 1)
    block = left[rows, u - half : u + half + 1]
    if int(block.max()) == int(block.min()):
        return None  # a flat block correlates with nothing
    scores = cv2.matchTemplate(right[rows, first : last + 1], block, cv2.TM_CCOEFF_NORMED)[0]
    best = int(np.argmax(scores))
    return u - (first + half + best) if scores[best] >= least_score else None
