"""Which patches of the left image are matched, and how a predicted shape places and bends them in the right.

``levels``, ``patch_size``, ``round_inset`` and ``cells`` decide at what size, how many and where; the plan of a rig
asks them too, and both say by ``shared`` how much of it the patches know in common.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from leadline.config import StereoConfig
from leadline.ranging.coarse import Box
from leadline.ranging.images import Float32, Region
from leadline.ranging.patches import Warp, bend_terms
from leadline.rig import Rig
from leadline.samples import Array
from leadline.target import Sphere, Surface, Target

LengthAt = Callable[[Array, Array], Array]  # origins, directions of rays (N, 3) -> lengths to the shape (N,)

NEAR_SIZE_M = 0.4  # a wall is matched in pixels as fine as a ball of this size beside it
ROUND_INSET = 0.9
CHOICES = 3  # places tried along each side of a cell
BEYOND = 1.01  # a length this much greater shows which way the epipolar curve goes
MIN_SCALE, MAX_SCALE = 0.2, 5.0  # of a patch's area between the two images
ALIKE = 1.4  # errors of two patches correlate as the part of their pixels that is common, to this power
_CORNERS = np.stack(np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]), axis=-1).reshape(-1, 2)
_MIDDLE = 4
_FIT = np.linalg.pinv(np.vstack([bend_terms(*_CORNERS.T), np.ones(9)])).T  # (6, 9)


def levels(settings: StereoConfig, focal_px: float, box: Box, range_m: float) -> tuple[int, int]:
    """Halvings at which a large target is matched, at first and in the end.

    One that is large and yet far off keeps the pixels that its range needs, once it is known to a few of them.
    """
    large, near = max(box[2], box[3]), focal_px * NEAR_SIZE_M / max(range_m, 0.1)
    coarse, fine = (
        max(0, round(float(np.log2(max(side, 1.0) / settings.target_px)))) for side in (large, min(large, near))
    )
    return coarse, fine


def patch_size(settings: StereoConfig, size_px: Array, level: int, larger: float = 1.0) -> tuple[int, int]:
    """Half a patch's side, and how many patches, for a box (2,) in pixels of the level.

    Patches are smaller on a small target, so that there are still enough of them, and as many as cover it.
    """
    side = float(np.sqrt(np.prod(size_px)))
    half = int(larger * np.clip(side / 8, settings.min_half_px, settings.half_px))
    covers = float(np.clip((side / (2 * half + 1)) ** 2, settings.patches / 2, settings.patches))
    return half, int((covers if level else settings.patches) / larger)  # no pixel is spare on a small target


def round_inset(target: Target) -> float | None:
    """The part of the box's ellipse that patches' centres may lie in; None for all of the box."""
    return ROUND_INSET if isinstance(target, Surface | Sphere) else None


def cells(size_px: Array, half: int, count: int) -> tuple[int, int]:
    """Columns and rows of a grid over a box (2,), with a patch in each cell."""
    step = max(float(np.sqrt(np.prod(size_px) / count)), half)
    columns, rows = np.maximum(np.round((size_px - half) / step), 1).astype(int)
    return int(columns), int(rows)


def centres(region: Region, low_px: Array, high_px: Array, half: int, count: int, inset: float | None) -> Array:
    """About ``count`` whole-pixel centres (N, 2), one in each cell of a grid, where its texture is richest.

    low_px, high_px: corners of the box in the region. inset: see ``round_inset``.
    """
    size = high_px - low_px
    columns, rows = cells(size, half, count)
    lines = [
        np.round(low_px[i] + size[i] * (np.arange(CHOICES * n) + 0.5) / (CHOICES * n)).astype(int)
        for i, n in enumerate((columns, rows))
    ]
    limits = [(half + 1, region.grey.shape[1 - i] - half - 2) for i in range(2)]
    inside = [(line >= least) & (line <= most) for line, (least, most) in zip(lines, limits, strict=True)]
    u, v = (np.clip(line, 0, region.grey.shape[1 - i] - 1) for i, line in enumerate(lines))
    value = np.where(inside[1][:, None] & inside[0], _texture(region.grey, half)[v[:, None], u], -1.0)
    if inset is not None:
        x, y = ((line - (low_px[i] + high_px[i]) / 2) / (size[i] / 2) for i, line in enumerate(lines))
        value[x**2 + y[:, None] ** 2 > inset**2] = -1.0
    split = value.reshape(rows, CHOICES, columns, CHOICES).transpose(0, 2, 1, 3).reshape(rows * columns, -1)
    best = split.argmax(axis=1)
    cell = np.flatnonzero(split[np.arange(len(split)), best] >= 0)
    row, column = cell // columns * CHOICES + best[cell] // CHOICES, cell % columns * CHOICES + best[cell] % CHOICES
    return np.stack([u[column], v[row]], axis=1).astype(float)


def shared(centre_px: Array, side_px: int) -> float:
    """By how much the variance of a mean of patches (N, 2) exceeds that of patches with no pixel in common.

    That is the mean sum of a patch's correlations with all. Two errors would correlate as the part of their pixels that
    is common, did a patch weigh all of them alike; it leans on some, for its slants. Measured: ``docs/plan.md``.
    """
    x, y = (np.abs(along[:, None] - along) for along in centre_px.T)
    common = (np.maximum(side_px - x, 0) * np.maximum(side_px - y, 0)).ravel() / side_px**2
    return float((common[common > 0] ** ALIKE).sum() / len(centre_px))


def _texture(image: Float32, half: int) -> Float32:
    """Mean square of the slope along rows over a patch at each pixel (H, W); ends are not exact."""
    slope = cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=1)
    return np.asarray(cv2.sqrBoxFilter(slope, cv2.CV_32F, (2 * half + 1, 2 * half + 1)), np.float32)


@dataclass(frozen=True, slots=True)
class Prediction:
    """N patches: where they are expected, at the region's level in the whole right image, and their middle rays.

    Pixels of the right image run almost evenly with 1 / length along a ray: ``rate_px_m`` (N,), at the level.
    """

    warp: Warp
    origins_m: Array
    directions: Array
    length_m: Array
    rate_px_m: Array

    def pick(self, keep: NDArray[np.bool_]) -> Prediction:
        rest = (self.origins_m, self.directions, self.length_m, self.rate_px_m)
        return Prediction(self.warp.pick(keep), *(values[keep] for values in rest))


def predicted(rig: Rig, region: Region, centre_px: Array, half: int, length_at: LengthAt) -> Prediction:
    """Of a shape; NaN where it is not met or not seen.

    From nine rays through each patch to the shape, and a tenth point farther along the middle one.
    """
    count = len(centre_px)
    q_px = region.to_full((centre_px[:, None] + half * _CORNERS).reshape(-1, 2))
    origins, directions = rig.rays(q_px, camera="left")
    length = length_at(origins, directions)
    p_m = origins + length[:, None] * directions
    middle = slice(_MIDDLE, None, 9)
    farther = origins[middle] + BEYOND * length[middle, None] * directions[middle]
    seen = (rig.project_one(np.concatenate([p_m, farther]), "right") + 0.5) / 2**region.level - 0.5
    patches = seen[: 9 * count].reshape(-1, 9, 2)
    along = patches[:, _MIDDLE] - seen[9 * count :]
    moved_px = np.sqrt(np.einsum("ni,ni->n", along, along))
    with np.errstate(invalid="ignore", divide="ignore"):
        along /= moved_px[:, None]
    scale = np.array([half, half, half**2, half**2, half**2])
    bend = patches.transpose(0, 2, 1) @ _FIT.T[:, :5] / scale
    warp = Warp(centre_px, half, patches[:, _MIDDLE].copy(), bend, along)
    rate = moved_px * length[middle] / (1 - 1 / BEYOND)
    return Prediction(warp, origins[middle], directions[middle], length[middle], rate)


def visible(warp: Warp, width: int, height: int, margin: float) -> NDArray[np.bool_]:
    """Whether patches (N,) lie well inside the right image and are not squeezed beyond recognition."""
    (a, b), (c, d) = warp.bend[:, 0, :2].T, warp.bend[:, 1, :2].T
    area, at = a * d - b * c, warp.expected_px
    with np.errstate(invalid="ignore"):
        keep = (area > MIN_SCALE) & (area < MAX_SCALE) & np.isfinite(warp.along).all(axis=1)
        return np.asarray(keep & ((at > margin) & (at < [width - margin, height - margin])).all(axis=1))
