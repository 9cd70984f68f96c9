"""The left patches of least-squares matching, and the instruments they are matched with (see ``patches``)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from leadline.ranging.images import Float32
from leadline.samples import Array

LEVEL = 0.1  # of the epipolar direction: below it the derivative across it is left out, an instrument need not be exact


def offsets(half: int, step: int = 1) -> tuple[Float32, Float32]:
    """(W,) dx, dy of a patch's pixels from its centre, rows first."""
    line = np.arange(-half, half + 1, step, dtype=np.float32)
    return np.tile(line, len(line)), np.repeat(line, len(line))


def blurred(image: Float32) -> Float32:
    return np.asarray(cv2.GaussianBlur(image, (3, 3), 0.8), np.float32)


def dots(a: Float32, b: Float32) -> Float32:
    """(N,) products of rows (N, W); a sum by ``sum`` takes three times as long."""
    return np.asarray(np.einsum("nw,nw->n", a, b))


def windows(image: Float32, centre_px: Array, reach: int) -> Float32:
    """(N, S, S) patches of an image, S = 2 reach + 1, around whole pixels (N, 2)."""
    (height, width), side = image.shape, 2 * reach + 1
    all_of_them = (height - side + 1, width - side + 1, side, side)
    views = np.ndarray(all_of_them, np.float32, image, strides=2 * image.strides)  # a tenth of the helpers' time
    columns, rows = centre_px.astype(int).T - reach
    return np.asarray(views[rows, columns])


@dataclass(frozen=True, slots=True)
class Weights:
    """Of a patch's pixels (W,), which stand in one row with a border of one pixel around them that counts for nothing.

    So neighbours in the image are neighbours in the row, or a row's width apart, and sums are products of matrices.
    """

    side: int
    inner: Float32  # (W,) one, and zero in the border
    slants: Float32  # (W, 3) how pixels move by a shift of one, and a slant of one in each direction at the edge
    products: Float32  # (W, 9) of these
    ninths: Float32  # (W, 9) each of nine parts

    @classmethod
    @cache
    def of(cls, half: int) -> Weights:
        dx, dy = offsets(half + 1)
        inner = (np.maximum(np.abs(dx), np.abs(dy)) <= half).astype(np.float32)
        slants = np.stack([inner, inner * dx / half, inner * dy / half], axis=1)
        third = [np.clip((t + half) * 3 // (2 * half + 1), 0, 2) for t in (dx, dy)]
        ninths = inner[:, None] * ((3 * third[1] + third[0])[:, None] == np.arange(9))
        products = (slants[:, :, None] * slants[:, None]).reshape(-1, 9)
        return cls(2 * half + 3, inner, slants, products, ninths.astype(np.float32))

    @property
    def count(self) -> np.float32:
        return np.float32((self.side - 2) ** 2)

    def centred(self, patches: Float32) -> Float32:
        """(N, W) less their means, zero in the border."""
        flat = patches - (patches @ self.inner / self.count)[:, None]
        flat *= self.inner
        return np.asarray(flat, np.float32)

    def across(self, patches: Float32) -> Float32:
        """Twice the derivative along rows (N, W), for all but the border."""
        return self._difference(patches, 1)

    def down(self, patches: Float32) -> Float32:
        return self._difference(patches, self.side)

    @staticmethod
    def _difference(patches: Float32, by: int) -> Float32:
        difference = np.empty_like(patches)
        difference[:, :by] = difference[:, -by:] = 0.0
        np.subtract(patches[:, 2 * by :], patches[:, : -2 * by], out=difference[:, by:-by])
        return difference

    def power(self, patches: Float32) -> Float32:
        """Variances (N,), by every third pixel, which is in every column."""
        third, inner = np.ascontiguousarray(patches[:, ::3]), self.inner[::3]
        count = inner.sum()
        third -= (third @ inner / count)[:, None]
        return np.asarray((third * third) @ inner / count)


class Templates:
    """The left patches, W pixels each, and the instruments they are matched with.

    Instrument i of a patch: slope * slant_i, made square to a constant and to the patch itself, whose level and gain
    are free. It is never written out: ``pull`` and ``response`` are its products with something else.
    """

    def __init__(self, left: Float32, centre_px: Array, half: int, back: Float32) -> None:
        """back: (N, 2) left pixels for a pixel of the shift."""
        self.weights = weights = Weights.of(half)
        grey, smooth = (
            windows(image, centre_px, half + 1).reshape(len(centre_px), -1) for image in (left, blurred(left))
        )
        self.clipped = np.count_nonzero((grey > 250) | (grey < 2), axis=1) / grey.shape[1]
        self.grey = weights.centred(grey)
        self.energy = dots(self.grey, self.grey) + np.float32(1e-6)
        self._back = 0.5 * back
        self._is_level = np.abs(self._back[:, 1]).max(initial=0.0) <= LEVEL / 2
        across, down = weights.across(smooth), weights.down(smooth)
        self.grain = _grain(*(weights.power(v) for v in (smooth, across, down)))
        self.slope = self._along(across, down)
        self.slope *= weights.inner
        self._mean = self.slope @ weights.slants / weights.count
        self._part = ((self.slope * self.grey) @ weights.slants) / self.energy[:, None]
        self.spread = self.response(self.slope)

    def slope_of(self, patches: Float32) -> Float32:
        """Derivative (N, W) by the shift, of patches (N, W); in the border anything."""
        return self._along(self.weights.across(patches), None if self._is_level else self.weights.down(patches))

    def _along(self, across: Float32, down: Float32 | None) -> Float32:
        slope = across * self._back[:, :1]
        if down is not None and not self._is_level:
            slope += down * self._back[:, 1:]
        return slope

    def pull(self, patches: Float32) -> Float32:
        """(N, 3) instruments times patches (N, W)."""
        slants = self.weights.slants
        sums, along = patches @ slants[:, :1], dots(self.grey, patches)[:, None]
        return np.asarray((self.slope * patches) @ slants - self._mean * sums - self._part * along)

    def response(self, slope: Float32) -> Float32:
        """(N, 3, 3) instruments times patches' derivatives by shift and slants, from their slope (N, W)."""
        whole = ((self.slope * slope) @ self.weights.products).reshape(-1, 3, 3)
        sums, along = slope @ self.weights.slants, (self.grey * slope) @ self.weights.slants
        whole -= self._mean[:, :, None] * sums[:, None]
        whole -= self._part[:, :, None] * along[:, None]
        return np.asarray(whole)

    def residual(self, patches: Float32, slope: Float32, step: Array) -> tuple[Float32, Float32]:
        """What is left (N, W) of patches after a last step (N, 3), and their gain (N, 1) over the left ones."""
        gain = np.minimum(np.maximum(dots(patches, self.grey) / self.energy, 0.2), 5.0)[:, None]
        left = slope * (step.astype(np.float32) @ self.weights.slants.T)
        left += self.weights.centred(patches)
        left /= gain
        left -= self.grey
        return left, gain


def _grain(texture: Float32, across: Float32, down: Float32) -> Float32:
    """Pixels (N,) over which a patch's texture is all of one piece: the area of its correlation's square.

    For a Gaussian correlation, which bends as the mean square of the slopes (here of twice them) says.
    """
    return np.asarray(4 * np.pi * texture / np.sqrt(across * down + np.float32(1e-6)))
