"""Image regions at a level of size, and exact sampling.

OpenCV 5's ``cv2.remap`` interpolates linearly at the very coordinates it is given (OpenCV 4 rounds them to 1/32 px). A
cubic B-spline is four such samples with weights (Sigg and Hadwiger, GPU Gems 2, chapter 20), exact and fast.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from leadline.samples import Array, Image

Float32 = NDArray[np.float32]

_POLE = np.sqrt(3.0) - 2.0  # of the filter that turns grey levels into B-spline coefficients (Unser 1993)
_PREFILTER = (np.sqrt(3.0) * _POLE ** np.abs(np.arange(-6, 7.0))).astype(np.float32)  # its tail: 1e-4


def _grey(image: Image) -> Image:
    return image if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


def _halved(image: Image | Float32) -> Image | Float32:
    """By area, which also averages the noise."""
    size = (image.shape[1] // 2, image.shape[0] // 2)
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)  # type: ignore[return-value]


@dataclass(frozen=True, slots=True)
class Region:
    """A part of an image, grey (H, W), halved ``level`` times; only this part is ever touched."""

    grey: Float32
    corner_px: Array  # (2,) x, y of its first pixel, in pixels of the level
    level: int

    @classmethod
    def of(cls, image: Image, level: int, low_px: Array, high_px: Array) -> Region:
        """The part of a whole image between two corners (2,), as much of it as there is, at least a few pixels."""
        block = 2**level
        whole = np.array([image.shape[1], image.shape[0]]) // block
        low = np.clip(np.floor(low_px / block), 0, np.maximum(whole - 4, 0)).astype(int)
        high = np.clip(np.ceil(high_px / block) + 1, low + 4, whole).astype(int)
        part = _grey(image[low[1] * block : high[1] * block, low[0] * block : high[0] * block])
        # The first halving rounds to whole grey levels, which the noise of a camera hides; later ones do not round.
        small = np.asarray(_halved(part) if level else part, np.float32)
        for _ in range(level - 1):
            small = _halved(small)  # type: ignore[assignment]
        return cls(small, low.astype(float), level)

    def to_here(self, q_px: Array) -> Array:
        """Pixels of the whole image to those of the region; pixel (0, 0) is the centre of the first pixel in both."""
        return np.asarray((q_px + 0.5) / 2**self.level - 0.5 - self.corner_px)

    def to_full(self, q_px: Array) -> Array:
        return np.asarray((q_px + self.corner_px + 0.5) * 2**self.level - 0.5)


def linear(image: Float32, x_px: Float32, y_px: Float32) -> Float32:
    """Linear interpolation at coordinates (N, W); beyond the border the border's own value."""
    return np.asarray(cv2.remap(image, x_px, y_px, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)


def spline_coefficients(image: Float32) -> Float32:
    """Of the cubic B-spline through an image's grey levels."""
    return np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, _PREFILTER, _PREFILTER), np.float32)


def cubic(coefficients: Float32, x_px: Float32, y_px: Float32) -> Float32:
    """The spline at coordinates (N, W): four linear samples, each standing for 2 x 2 coefficients."""
    x0, x1, right = _pairs(x_px)
    y0, y1, below = _pairs(y_px)
    upper, lower = linear(coefficients, x0, y0), linear(coefficients, x0, y1)
    upper += right * (linear(coefficients, x1, y0) - upper)
    lower += right * (linear(coefficients, x1, y1) - lower)
    upper += below * (lower - upper)
    return upper


def _pairs(t: Float32) -> tuple[Float32, Float32, Float32]:
    """Where to sample in each of the two pairs of coefficients, and the second pair's weight."""
    whole = np.floor(t)
    f = t - whole
    f3 = f * f * f
    second = (1 / 6 + 0.5 * f) + (0.5 * f * f - (1 / 3) * f3)
    first = 1 - second
    middle = (2 / 3 - f * f) + 0.5 * f3
    return whole - 1 + middle / first, whole + 1 + f3 / (6 * second), second
