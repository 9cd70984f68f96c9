"""A first depth from nothing but the box: patches swept along their refracted epipolar curves, and a common vote."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from leadline.ranging.images import Float32, shrink, to_full, to_level
from leadline.ranging.shape_fit import Points
from leadline.rig import Rig
from leadline.samples import Array

NEAREST_M, FARTHEST_M = 0.15, 30.0
BOX_PX = 128  # the box is shrunk to about this size
HALF = 8
COLUMNS, ROWS = 9, 7
INNER = 0.7  # of the box: its corners are not the target
STEP_PX = 0.7
MIN_CORRELATION = 0.5
WINDOW = (0.7, 1.5)  # of the common depth: how far a patch may stand from it

Box = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Sweep:
    """Correlation (N, K) of N patches at K lengths along their rays."""

    lengths_m: Array
    scores: Array
    origins_m: Array
    directions: Array


def coarse_points(rig: Rig, left: Float32, right: Float32, box: Box) -> Points | None:
    """Points on the target, good to a pixel of the shrunk image; None where the patches find nothing in common."""
    level = max(0, int(np.floor(np.log2(max(box[2], box[3]) / BOX_PX))))
    sweep = _sweep(rig, shrink(left, level), shrink(right, level), box, level)
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
    sigma = length**2 * (1 / NEAREST_M - 1 / FARTHEST_M) / len(sweep.lengths_m)
    return Points(sweep.origins_m, sweep.directions, length, sigma).pick(keep)


def _grid(box: Box, level: int, shape: tuple[int, int]) -> Array:
    """Whole-pixel patch centres (N, 2) at the level, over the inner part of the box, clear of the border."""
    x, y, width, height = box
    u = x + width * (0.5 + INNER * np.linspace(-0.5, 0.5, COLUMNS))
    v = y + height * (0.5 + INNER * np.linspace(-0.5, 0.5, ROWS))
    q_px = np.round(to_level(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2), level))
    clear = (q_px >= HALF).all(axis=1) & (q_px[:, 0] < shape[1] - HALF) & (q_px[:, 1] < shape[0] - HALF)
    return np.asarray(np.unique(q_px[clear], axis=0))


def _sweep(rig: Rig, left: Float32, right: Float32, box: Box, level: int) -> Sweep | None:
    q_px = _grid(box, level, left.shape)
    if len(q_px) < 4:
        return None
    origins, directions = rig.rays(to_full(q_px, level), camera="left")
    ends = np.array([NEAREST_M, FARTHEST_M])
    across = _seen(rig, origins, directions, ends, level)[:, :, 0]
    spans = np.abs(across[:, 0] - across[:, 1])
    if not np.isfinite(spans).any():
        return None
    lengths = 1 / np.linspace(1 / NEAREST_M, 1 / FARTHEST_M, max(int(np.nanmax(spans) / STEP_PX), 16))
    seen = _seen(rig, origins, directions, lengths, level)
    window = np.arange(-HALF, HALF + 1)
    scores = np.full(seen.shape[:2], -1.0)
    for i, (u, v) in enumerate(q_px.astype(int)):
        patch = left[v - HALF : v + HALF + 1, u - HALF : u + HALF + 1]
        x = seen[i, :, 0, None, None] + window[None, None, :] + 0 * window[None, :, None]
        y = seen[i, :, 1, None, None] + window[None, :, None] + 0 * window[None, None, :]
        sampled = _bilinear(right, x.reshape(len(lengths), -1), y.reshape(len(lengths), -1))
        scores[i] = _correlate(patch.ravel(), sampled)
    with np.errstate(invalid="ignore"):
        inside = ((seen >= HALF) & (seen < [right.shape[1] - HALF, right.shape[0] - HALF])).all(axis=2)
    return Sweep(lengths, np.where(inside, scores, -1.0), origins, directions)


def _seen(rig: Rig, origins_m: Array, directions: Array, lengths_m: Array, level: int) -> Array:
    """Right pixels (N, K, 2), at the level, of points along rays."""
    p_m = origins_m[:, None] + lengths_m[None, :, None] * directions[:, None]
    q_px = rig.project(p_m.reshape(-1, 3))[1]
    return to_level(q_px, level).reshape(len(origins_m), len(lengths_m), 2)


def _bilinear(image: Float32, x: Array, y: Array) -> Float32:
    maps = np.nan_to_num(x, nan=-1e4).astype(np.float32), np.nan_to_num(y, nan=-1e4).astype(np.float32)
    return np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)


def _correlate(patch: Float32, sampled: Float32) -> Array:
    """Zero-mean normalised correlation (K,) of one patch (W,) with K samplings (K, W)."""
    a = patch - patch.mean()
    b = sampled - sampled.mean(axis=1, keepdims=True)
    return np.asarray(b @ a / (np.linalg.norm(a) * np.linalg.norm(b, axis=1) + 1e-3), float)


def _vote(sweep: Sweep) -> float:
    """The length at which most patches correlate, smoothed over the depth that one target may have."""
    votes = (np.clip(sweep.scores, 0, None) ** 2).sum(axis=0)
    wide = max(3, len(votes) // 20) | 1
    smooth = np.convolve(np.pad(votes, wide // 2, mode="edge"), np.hanning(wide + 2)[1:-1], mode="valid")
    return float(sweep.lengths_m[int(smooth.argmax())])
