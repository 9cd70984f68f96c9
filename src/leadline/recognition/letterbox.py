"""An image as a network's input: scaled to fit, centred on grey."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from leadline.errors import InputError
from leadline.samples import Image

GREY = 114  # what fills the border; the value that the common trainers use


@dataclass(frozen=True, slots=True)
class Fitted:
    """``canvas`` (h, w, 3) uint8 BGR holds the image: q_canvas = scale * q + (left, top)."""

    canvas: Image
    scale: float
    left: int
    top: int


def letterbox(image: Image, size: tuple[int, int]) -> Fitted:
    """``image`` (H, W, 3) on a canvas of ``size`` (w, h)."""
    height, width = image.shape[:2]
    scale = min(size[0] / width, size[1] / height)
    fitted = (max(1, round(width * scale)), max(1, round(height * scale)))
    left, top = (size[0] - fitted[0]) // 2, (size[1] - fitted[1]) // 2
    small = _resized(image, fitted)
    if fitted == size:
        return Fitted(small, scale, left, top)
    canvas = np.full((size[1], size[0], 3), GREY, np.uint8)
    canvas[top : top + fitted[1], left : left + fitted[0]] = small
    return Fitted(canvas, scale, left, top)


def planes(canvas: Image, dtype: Any = np.float32, *, bgr_255: bool = False) -> NDArray[Any]:
    """(h, w, 3) BGR -> (1, 3, h, w): RGB in 0..1, or BGR in 0..255 where asked; bytes stay 0..255.

    Half of ``cv2.dnn.blobFromImage``'s time.
    """
    pixels = np.empty((1, 3, *canvas.shape[:2]), np.float32 if dtype == np.float16 else dtype)
    channels = cv2.split(canvas)
    factor = np.float32(1.0 if bgr_255 else 1 / 255)
    for plane, channel in zip(pixels[0], channels if bgr_255 else channels[::-1], strict=True):
        if dtype == np.uint8:
            plane[:] = channel
        else:
            np.multiply(channel, factor, out=plane)
    return pixels.astype(dtype, copy=False)


def three_channels(image: Image) -> Image:
    """Grey (H, W) or (H, W, 1) and colour (H, W, 3) bytes as colour; InputError for anything else."""
    if image.dtype != np.uint8:
        raise InputError(f"an image of {image.dtype}", fix="give 8 bit: cv2.convertScaleAbs(image, alpha=1 / 256)")
    if image.ndim == 2 or image.shape[2:] == (1,):
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)
    if image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise InputError(f"an image of shape {'x'.join(map(str, image.shape))}", fix="give (H, W, 3) BGR or (H, W)")
    return image


def _resized(image: Image, size: tuple[int, int]) -> Image:
    """Exact halvings by averaging while the image is twice ``size`` or more: no aliasing, at a fraction of the cost."""
    while image.shape[1] >= 2 * size[0] and image.shape[0] % 2 == 0 and image.shape[1] % 2 == 0:
        half = (image.shape[1] // 2, image.shape[0] // 2)
        image = np.asarray(cv2.resize(image, half, interpolation=cv2.INTER_AREA), np.uint8)
    if (image.shape[1], image.shape[0]) == size:
        return image
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_LINEAR), np.uint8)
