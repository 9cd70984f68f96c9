"""A first depth from nothing but the box: patches swept along their refracted epipolar curves, and a common vote."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from leadline.ranging.images import Float32, Region, linear
from leadline.ranging.shape_fit import Points
from leadline.rig import Rig
from leadline.samples import Array, Image

NEAREST_M, FARTHEST_M = 0.15, 30.0
NODES = 12  # of the polynomial that a curve is between them, over 1 / length: good to 0.01 px
BOX_PX = 128  # the box is shrunk to about this size
HALF, SPARSE = 8, 2  # a patch's pixels: every second one of 17 x 17
COLUMNS, ROWS = 9, 7
INNER = 0.7  # of the box: its corners are not the target
STEP_PX = 0.7
MIN_CORRELATION = 0.5
FAINT = 0.7  # grey levels: what is no stronger, the glow of the water above all, correlates with anything
SLANTED = 0.03  # of its length: how well a patch is placed that is taken for square to the view and is not
WINDOW = (0.7, 1.5)  # of the common depth: how far a patch may stand from it

Box = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Sweep:
    """Correlation (N, K) of N patches at K lengths along their rays."""

    lengths_m: Array
    scores: Float32
    origins_m: Array
    directions: Array


def coarse_points(rig: Rig, left: Image, right: Image, box: Box) -> Points | None:
    """Points on the target, good to a pixel of the shrunk image; None where the patches find nothing in common."""
    sweep = _sweep(rig, left, right, box)
    if sweep is None:
        return None
    common = _vote(sweep)
    inside = (sweep.lengths_m > WINDOW[0] * common) & (sweep.lengths_m < WINDOW[1] * common)
    best = np.where(inside, sweep.scores, -1.0).argmax(axis=1)
    score = sweep.scores[np.arange(len(best)), best]
    keep = score > MIN_CORRELATION
    if keep.sum() < 4:
        return None
    length = sweep.lengths_m[best]
    step = length**2 * (1 / NEAREST_M - 1 / FARTHEST_M) / len(sweep.lengths_m)
    sigma = np.hypot(step, SLANTED * length)
    return Points(sweep.origins_m, sweep.directions, length, sigma).pick(keep)


def _grid(box: Box, region: Region) -> Array:
    """Whole-pixel patch centres (N, 2) of the region, over the inner part of the box, clear of the border."""
    x, y, width, height = box
    u = x + width * (0.5 + INNER * np.linspace(-0.5, 0.5, COLUMNS))
    v = y + height * (0.5 + INNER * np.linspace(-0.5, 0.5, ROWS))
    q_px = np.round(region.to_here(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)))
    rows, columns = region.grey.shape
    clear = (q_px >= HALF).all(axis=1) & (q_px[:, 0] < columns - HALF) & (q_px[:, 1] < rows - HALF)
    return np.asarray(np.unique(q_px[clear], axis=0))


def _sweep(rig: Rig, left_image: Image, right_image: Image, box: Box) -> Sweep | None:
    level = max(0, int(np.floor(np.log2(max(box[2], box[3], 1.0) / BOX_PX))))
    low, high = np.array(box[:2]), np.array(box[:2]) + box[2:]
    left = Region.of(left_image, level, low - HALF * 2**level, high + HALF * 2**level)
    q_px = _grid(box, left)
    if len(q_px) < 4:
        return None
    origins, directions = rig.rays(left.to_full(q_px), camera="left")
    nodes = np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)  # Chebyshev's
    near, far = 1 / NEAREST_M, 1 / FARTHEST_M
    curve_px = _seen(rig, origins, directions, 2 / (near + far + nodes * (near - far)))
    if not np.isfinite(curve_px).all(axis=(1, 2)).any():
        return None
    margin = 2 * HALF * 2**level
    ends = curve_px.reshape(-1, 2)
    right = Region.of(right_image, level, np.nanmin(ends, axis=0) - margin, np.nanmax(ends, axis=0) + margin)
    span = np.nanmax(np.ptp(curve_px, axis=1)) / 2**level
    inverse = np.linspace(near, far, max(int(span / STEP_PX), 16))
    basis = np.linalg.pinv(_chebyshev(nodes)).T @ _chebyshev((2 * inverse - near - far) / (near - far)).T
    seen = (right.to_here(curve_px).transpose(2, 0, 1) @ basis).astype(np.float32)  # (2, N, K)
    scores = _scores(_blurred(left.grey), _blurred(right.grey), q_px.astype(int), seen)
    with np.errstate(invalid="ignore"):
        edge = np.array(right.grey.shape[::-1])[:, None, None] - HALF
        inside = ((seen >= HALF) & (seen < edge)).all(axis=0)
    return Sweep(1 / inverse, np.where(inside, scores, np.float32(-1)), origins, directions)


def _chebyshev(t: Array) -> Array:
    """(len(t), NODES) of the polynomials T_0, T_1, ..."""
    return np.asarray(np.cos(np.arange(NODES) * np.arccos(np.clip(t, -1, 1))[:, None]))


def _blurred(image: Float32) -> Float32:
    return np.asarray(cv2.GaussianBlur(image, (3, 3), 0.8), np.float32)


def _scores(left: Float32, right: Float32, q_px: Array, seen: Float32) -> Float32:
    """Zero-mean normalised correlation (N, K) of patches with what is seen at K places (2, N, K) each."""
    offset = np.arange(-HALF, HALF + 1, SPARSE)
    dx, dy = (v.ravel().astype(np.float32) for v in np.meshgrid(offset, offset))
    scores = np.empty(seen.shape[1:], np.float32)
    places, faint = np.nan_to_num(seen, nan=-1e4), np.float32(FAINT**2 * len(dx))
    for i, (u, v) in enumerate(q_px):
        patch = left[v - HALF : v + HALF + 1 : SPARSE, u - HALF : u + HALF + 1 : SPARSE].ravel()
        patch = patch - patch.mean()
        sampled = linear(right, places[0, i, :, None] + dx, places[1, i, :, None] + dy)
        # The patch has no mean, so that the sampled one's need not be taken off.
        power = np.einsum("kw,kw->k", sampled, sampled) - sampled.sum(axis=1) ** 2 / np.float32(len(patch))
        scores[i] = sampled @ patch / np.sqrt((patch @ patch + faint) * (np.maximum(power, 0) + faint))
    return scores


def _seen(rig: Rig, origins_m: Array, directions: Array, lengths_m: Array) -> Array:
    """Right pixels (N, K, 2) of points along rays."""
    p_m = origins_m[:, None] + lengths_m[None, :, None] * directions[:, None]
    return rig.project_one(p_m.reshape(-1, 3), "right").reshape(len(origins_m), len(lengths_m), 2)


def _vote(sweep: Sweep) -> float:
    """The length at which most patches correlate, smoothed over the depth that one target may have."""
    votes = (np.clip(sweep.scores, 0, None) ** 2).sum(axis=0)
    wide = max(3, len(votes) // 20) | 1
    smooth = np.convolve(np.pad(votes, wide // 2, mode="edge"), np.hanning(wide + 2)[1:-1], mode="valid")
    return float(sweep.lengths_m[int(smooth.argmax())])
