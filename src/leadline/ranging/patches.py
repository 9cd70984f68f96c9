"""Least-squares matching of patches between the two images, along given directions, with slant and brightness.

A patch is a square of the left image; a warp says where its pixels are expected in the right one. The right place is
found by a shift along the epipolar direction that may vary linearly over the patch (slant), with gain and offset of
brightness free (Gruen 1985, "Adaptive least squares correlation"). All patches are solved together, vectorised.

The smooth derivative of the left patch is an instrument, its response is measured in the right patch: their noises are
independent, so that noise neither counts as texture nor slows the steps, and fine texture is not overshot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from functools import cache

import numpy as np
from numpy.typing import NDArray

from leadline.ranging.images import HALFWAY, Float32, doubled, linear
from leadline.ranging.templates import Templates, blurred, dots, offsets, windows
from leadline.samples import Array

STEPS, CLOSE_PX = 4, 0.15  # after a step that is so small the next ones are as good as nothing
MAX_STEP_PX = 0.7
STRAGGLERS = 0.1
ALIKE = 0.5  # the least correlation of a place that may be taken for another
MAX_RUN_PX = 2.0  # from the search, which cannot be wrong by more
MAX_SLANT_PX = 4.0
ROUNDED, UNLIKE = 1 / 12, 0.02  # least residual: whole grey levels; interpolation, as a part of the texture
_FIRST = np.eye(3, 1, dtype=np.float32)
_NUDGE = np.float32(1e-3) * np.eye(3, dtype=np.float32)


class Verdict(IntEnum):
    """Whether a patch is matched, else why it is not."""

    MATCHED = 0
    LEFT_THE_IMAGE = 1
    OVER_EXPOSED = 2
    SMOOTH = 3
    REPEATED = 4
    DIFFERENT = 5
    COVERED = 6
    RAN_AWAY = 7


@dataclass(frozen=True, slots=True)
class Limits:
    """What still is a match."""

    signal: float = 0.3  # texture along the curve that both images share, over texture and noise of one
    sigma_px: float = 0.6
    correlation: float = 0.3
    clipped: float = 0.04  # part of the pixels that may be black or white
    chance: float = 0.01  # that unrelated texture of the same grain correlates as well
    parts: float = 3.5  # sigmas that a ninth of the patch may pull


@dataclass(frozen=True, slots=True)
class Warp:
    """Where patches are expected in the right image. N patches of (2 half + 1)^2 pixels."""

    centre_px: Array  # (N, 2) integers, left
    half: int
    expected_px: Array  # (N, 2) right
    bend: Array  # (N, 2, 5) right pixels for dx, dy, dx^2, dx dy, dy^2: tilt, curvature and refraction of the surface
    along: Array  # (N, 2) unit direction of the epipolar curve, right

    def pick(self, keep: NDArray[np.bool_]) -> Warp:
        return Warp(self.centre_px[keep], self.half, self.expected_px[keep], self.bend[keep], self.along[keep])


@dataclass(frozen=True, slots=True)
class Found:
    """Of the search (N,): the best shift, the correlation there, and whether another place is about as good."""

    shift_px: Array
    correlation: Array
    repeated: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Matches:
    """Shift (N,) along the direction, its sigma, the correlation, and the verdict; shift NaN where not matched."""

    shift_px: Array
    sigma_px: Array
    correlation: Array
    verdict: NDArray[np.int8]


def bend_terms(dx: Array | Float32, dy: Array | Float32) -> Array | Float32:
    """(5, W) what ``Warp.bend`` multiplies."""
    return np.stack([dx, dy, dx * dx, dx * dy, dy * dy])


@cache
def _terms(half: int, step: int) -> Float32:
    """(6, W) what places are linear in: ``bend_terms``, and one for the middle."""
    dx, dy = offsets(half, step)
    return np.asarray(np.concatenate([bend_terms(dx, dy), np.ones((1, len(dx)))]), np.float32)


class _Places:
    """Right coordinates of the patches' pixels, as functions of shift and slant; of an image ``larger`` than it was."""

    def __init__(self, warp: Warp, reach: int, step: int = 1, larger: int = 1) -> None:
        self._terms = _terms(reach, step)
        self._place = np.concatenate([warp.bend, warp.expected_px[:, :, None]], axis=2).transpose(1, 0, 2)[:, :, None]
        self._along, self._slant = warp.along.T[:, :, None, None], np.eye(3, 6, 5) + np.eye(3, 6, -1) / warp.half
        self._larger = larger

    def at(self, p: Array) -> tuple[Float32, Float32]:
        """(N K, W) each, for K shifts and slants of every patch (N, K, 3), slants in px at the patch's edge."""
        place = (self._larger * (self._place + self._along * (p @ self._slant))).astype(np.float32)
        x, y = place.reshape(2, -1, 6) @ self._terms
        return x, y


def search(left: Float32, right: Float32, warp: Warp, reach_px: float) -> Found:
    """The best shift within +-reach, to a fraction of a pixel; on slightly blurred images, every second pixel."""
    step = 2 if warp.half > 5 else 1
    patches = windows(blurred(left), warp.centre_px, warp.half)[:, ::step, ::step]
    template = _normalised(patches.reshape(len(patches), -1))
    shifts = np.arange(-np.ceil(reach_px), np.ceil(reach_px) + 1)
    p = np.zeros((len(template), len(shifts), 3))
    p[:, :, 0] = shifts
    flat = blurred(right)
    flat -= flat.mean()  # so that sums of squares keep their digits
    sampled = linear(flat, *_Places(warp, warp.half, step).at(p))
    power = dots(sampled, sampled) - np.einsum("nw->n", sampled) ** 2 / np.float32(sampled.shape[1])
    table = (sampled.reshape(len(template), len(shifts), -1) @ template[:, :, None])[:, :, 0]
    table /= np.sqrt(np.maximum(power, 0) + np.float32(1e-6)).reshape(table.shape)
    fraction, height = _peaks(table)
    rows, best = np.arange(len(table)), height.argmax(axis=1)
    score = height[rows, best]
    height[np.abs(np.arange(len(shifts)) - best[:, None]) <= 1] = -1
    repeated = height.max(axis=1) > np.maximum(score - 0.5 * (1 - score) - 0.05, ALIKE)
    return Found(shifts[best] + fraction[rows, best], score, repeated)


def _peaks(table: Float32) -> tuple[Float32, Float32]:
    """Of rows (N, K): how far (N, K) a peak is from its sample, and its height, by a parabola; -1 where there is none.

    An end that is higher than its neighbour is taken for a peak.
    """
    wide = np.concatenate([table[:, :1], table, table[:, -1:]], axis=1)
    low, high = wide[:, :-2], wide[:, 2:]
    bow = np.minimum(low - 2 * table + high, np.float32(-1e-6))
    peak = (table >= low) & (table >= high)
    fraction = np.minimum(np.maximum(0.5 * (low - high) / bow, -0.5), 0.5)
    fraction[:, [0, -1]] = 0
    return fraction, np.where(peak, table - 0.25 * (low - high) * fraction, np.float32(-1))


def _normalised(patches: Float32) -> Float32:
    centred = patches - patches.mean(axis=1, keepdims=True)
    centred /= np.sqrt(dots(centred, centred) + 1e-6)[:, None]
    return np.asarray(centred, np.float32)


def _back(warp: Warp) -> Float32:
    """(N, 2) left pixels for a pixel along the curve in the right image."""
    ((a, c), (b, d)), (u, v) = warp.bend[:, :, :2].T, warp.along.T
    return np.asarray(np.stack([d * u - b * v, a * v - c * u], axis=1) / (a * d - b * c)[:, None], np.float32)


def refine(left: Float32, right: Float32, warp: Warp, start_px: Array, limits: Limits | None = None) -> Matches:
    """Sub-pixel shifts from shifts good to a pixel or so, with the sigma that noise and texture imply."""
    if not len(start_px):
        return Matches(np.empty(0), np.empty(0), np.empty(0), np.empty(0, np.int8))
    templates = Templates(left, warp.centre_px, warp.half, _back(warp))
    places, fine = _Places(warp, warp.half + 1, larger=2), doubled(right)
    p = np.concatenate([start_px[:, None], np.zeros((len(start_px), 2))], axis=1)
    for taken in range(STEPS):
        x, y = places.at(p[:, None])
        sampled = linear(fine, x, y)
        slope = templates.slope_of(sampled)
        response = templates.response(slope)
        step = _step(response, templates.pull(sampled))
        p = p + step
        if taken and _mostly_within(step, CLOSE_PX):
            break
    residual, gain = templates.residual(sampled, slope, step)
    response /= gain[:, :, None]
    lost = (np.abs(p[:, 0] - start_px) > MAX_RUN_PX) | (np.abs(step[:, 0]) > CLOSE_PX)
    outside = _outside(x, y, fine)
    return _judge(templates, residual, response, p, lost, outside, _thinned(x, y), limits or Limits())


def _outside(x: Float32, y: Float32, image: Float32) -> NDArray[np.bool_]:
    """Whether patches (N,), by their corners, reach beyond an image."""
    side = math.isqrt(x.shape[1])
    corners = [0, side - 1, -side, -1]
    beyond = [
        (t < 2) | (t > size - 4) for t, size in ((x[:, corners], image.shape[1]), (y[:, corners], image.shape[0]))
    ]
    return np.asarray((beyond[0] | beyond[1]).any(axis=1))


def _step(response: Float32, pull: Float32) -> Array:
    """(N, 3) towards where the instruments pull no more."""
    step = np.linalg.solve(_regular(response), pull[:, :, None])[:, :, 0]
    return np.asarray(np.minimum(np.maximum(-step, -MAX_STEP_PX), MAX_STEP_PX), np.float64)


def _mostly_within(step: Array, limit_px: float) -> bool:
    """All but a few patches, which have nothing to settle on."""
    return bool(np.count_nonzero(np.abs(step[:, 0]) > limit_px) <= STRAGGLERS * len(step))


def _regular(response: Float32) -> Float32:
    """The same, but not singular where a patch is even."""
    return response + _NUDGE


def _thinned(x: Float32, y: Float32) -> Array:
    """How much of white noise's variance sampling in a doubled image leaves (N,), by a few of the pixels."""
    left = np.ones(len(x))
    for t in (x[:, ::37], y[:, ::37]):
        f = np.abs(t - 2 * np.round(0.5 * t))  # of the way from a whole pixel to a half one
        left *= (1 - f * (2 - 2 * HALFWAY[0] - (1 - 2 * HALFWAY[0] + HALFWAY[1]) * f)).mean(axis=1)
    return left


def _judge(
    template: Templates,
    residual: Float32,
    response: Float32,
    p: Array,
    lost: NDArray[np.bool_],
    outside: NDArray[np.bool_],
    thinned: Array,
    limits: Limits,
) -> Matches:
    """Sigma of the shift by the sandwich rule, and the verdict."""
    width = template.weights.count
    variance = dots(residual, residual) / (width - 5)
    dense = 2 / (1 + thinned)  # the noise at the low frequencies that matter, over that of a pixel
    noise = variance * dense
    spread = template.spread
    smooth = ~(response[:, 0, 0] > limits.signal * spread[:, 0, 0])
    first = np.linalg.solve(_regular(response).transpose(0, 2, 1), _FIRST)  # row of the inverse
    sigma = np.sqrt(np.maximum(noise * (first.transpose(0, 2, 1) @ spread @ first)[:, 0, 0], 0))
    texture = template.energy / width
    correlation = np.sqrt(np.maximum(1 - variance / (texture + variance), 0))
    verdict = np.zeros(len(p), np.int8)
    chance = (1 - np.minimum(correlation, 0.9999) ** 2) ** (0.5 * np.maximum(width / (template.grain + 0.1) - 2, 0))
    for kind, wrong in (
        (Verdict.COVERED, _parts(template, residual, dense) > limits.parts),
        (Verdict.DIFFERENT, (chance > limits.chance) | (correlation < limits.correlation)),
        (Verdict.SMOOTH, smooth | (sigma > limits.sigma_px)),
        (Verdict.RAN_AWAY, lost | (np.abs(p[:, 1:]).max(axis=1) > MAX_SLANT_PX)),
        (Verdict.OVER_EXPOSED, template.clipped > limits.clipped),
        (Verdict.LEFT_THE_IMAGE, outside | ~np.isfinite(p).all(axis=1)),
    ):
        verdict[wrong] = kind
    matched = verdict == Verdict.MATCHED
    return Matches(np.where(matched, p[:, 0], np.nan), np.where(matched, sigma, np.nan), correlation, verdict)


def _parts(template: Templates, residual: Float32, dense: Array) -> Array:
    """How many sigmas (N,) the strongest of nine parts of a patch would pull the shift its own way.

    Where something covers a part of the patch in one of the images, that part pulls and the others hold against it.
    The noise is that of the middle one of the parts: what covers the others does not add to it.
    """
    ninths = template.weights.ninths
    pull, scale = (template.slope * residual) @ ninths, (template.slope**2) @ ninths
    power = np.partition((residual * residual) @ ninths / ninths.sum(axis=0), 4, axis=1)[:, 4]
    noise = power * dense
    noise += ROUNDED + UNLIKE**2 * template.energy / template.weights.count
    return np.asarray((np.abs(pull) / np.sqrt(scale * noise[:, None] + np.float32(1e-9))).max(axis=1), float)
