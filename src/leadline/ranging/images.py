"""Image levels and exact sampling.

`cv2.remap` of OpenCV 4 quantises coordinates to 1/32 px, which would show in the result; a cubic spline has no table.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from leadline.samples import Array, Image

Float32 = NDArray[np.float32]


def grey(image: Image) -> Float32:
    """(H, W) float32, grey levels 0 to 255."""
    flat = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return np.asarray(flat, np.float32)


def shrink(image: Float32, level: int) -> Float32:
    """Halve ``level`` times by area, which also averages the noise."""
    for _ in range(level):
        image = cv2.resize(image, (image.shape[1] // 2, image.shape[0] // 2), interpolation=cv2.INTER_AREA)  # type: ignore[assignment]
    return image


def to_level(q_px: Array, level: int) -> Array:
    """Full-size pixel coordinates to those of a level; pixel (0, 0) is the centre of the first pixel at both."""
    return np.asarray((q_px + 0.5) / 2**level - 0.5)


def to_full(q_px: Array, level: int) -> Array:
    return np.asarray((q_px + 0.5) * 2**level - 0.5)


@dataclass(frozen=True, slots=True)
class Spline:
    """A region of an image as a cubic spline: sampled exactly anywhere inside; NaN outside."""

    coefficients: Float32
    corner_px: Array  # (2,) x, y of the region's first pixel

    @classmethod
    def of(cls, image: Float32, around_px: Array, margin_px: float) -> Spline:
        """The region that holds the points (N, 2) with a margin."""
        low = np.clip(np.floor(np.nanmin(around_px, axis=0) - margin_px), 0, None).astype(int)
        high = np.ceil(np.nanmax(around_px, axis=0) + margin_px).astype(int) + 1
        region = image[low[1] : max(high[1], low[1] + 2), low[0] : max(high[0], low[0] + 2)]
        return cls(ndimage.spline_filter(region, order=3, output=np.float32, mode="mirror"), low.astype(float))

    def sample(self, x_px: Array, y_px: Array) -> Float32:
        """Grey levels at coordinates of any shape."""
        where = np.stack([y_px - self.corner_px[1], x_px - self.corner_px[0]])
        return np.asarray(
            ndimage.map_coordinates(
                self.coefficients, where, order=3, prefilter=False, mode="constant", cval=np.nan, output=np.float32
            )
        )
