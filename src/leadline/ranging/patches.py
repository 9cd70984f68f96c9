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

import cv2
import numpy as np
from numpy.typing import NDArray

from leadline.ranging.images import HALFWAY, Float32, doubled, linear
from leadline.samples import Array

STEPS, CLOSE_PX = 4, 0.15  # after a step that is so small the next ones are as good as nothing
MAX_STEP_PX = 0.7
STRAGGLERS = 0.1
ALIKE = 0.5  # the least correlation of a place that may be taken for another
MAX_RUN_PX = 2.0  # from the search, which cannot be wrong by more
MAX_SLANT_PX = 4.0
ROUNDED, UNLIKE = 1 / 12, 0.02  # least residual: whole grey levels; interpolation, as a part of the texture
LEVEL = 0.1  # of the epipolar direction: below it the derivative across it is left out, an instrument need not be exact
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


def offsets(half: int, step: int = 1) -> tuple[Float32, Float32]:
    """(W,) dx, dy of a patch's pixels from its centre, rows first."""
    line = np.arange(-half, half + 1, step, dtype=np.float32)
    return np.tile(line, len(line)), np.repeat(line, len(line))


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
    template = _normalised(_windows(_blurred(left), warp, 0)[:, ::step, ::step].reshape(len(warp.centre_px), -1))
    shifts = np.arange(-np.ceil(reach_px), np.ceil(reach_px) + 1)
    p = np.zeros((len(template), len(shifts), 3))
    p[:, :, 0] = shifts
    flat = _blurred(right)
    flat -= flat.mean()  # so that sums of squares keep their digits
    sampled = linear(flat, *_Places(warp, warp.half, step).at(p))
    power = _dots(sampled, sampled) - np.einsum("nw->n", sampled) ** 2 / np.float32(sampled.shape[1])
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


def _blurred(image: Float32) -> Float32:
    return np.asarray(cv2.GaussianBlur(image, (3, 3), 0.8), np.float32)


def _dots(a: Float32, b: Float32) -> Float32:
    """(N,) products of rows (N, W); a sum by ``sum`` takes three times as long."""
    return np.asarray(np.einsum("nw,nw->n", a, b))


def _normalised(patches: Float32) -> Float32:
    centred = patches - patches.mean(axis=1, keepdims=True)
    centred /= np.sqrt(_dots(centred, centred) + 1e-6)[:, None]
    return np.asarray(centred, np.float32)


def _windows(image: Float32, warp: Warp, room: int) -> Float32:
    """(N, S, S) patches of an image around the warp's centres, ``room`` pixels wider on each side."""
    reach = warp.half + room
    (height, width), side = image.shape, 2 * reach + 1
    all_of_them = (height - side + 1, width - side + 1, side, side)
    views = np.ndarray(all_of_them, np.float32, image, strides=2 * image.strides)  # a tenth of the helpers' time
    columns, rows = warp.centre_px.astype(int).T - reach
    return np.asarray(views[rows, columns])


@dataclass(frozen=True, slots=True)
class _Weights:
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
    def of(cls, half: int) -> _Weights:
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


def _back(warp: Warp) -> Float32:
    """(N, 2) left pixels for a pixel along the curve in the right image."""
    ((a, c), (b, d)), (u, v) = warp.bend[:, :, :2].T, warp.along.T
    return np.asarray(np.stack([d * u - b * v, a * v - c * u], axis=1) / (a * d - b * c)[:, None], np.float32)


class _Templates:
    """The left patches, W pixels each, and the instruments they are matched with.

    Instrument i of a patch: slope * slant_i, made square to a constant and to the patch itself, whose level and gain
    are free. It is never written out: ``pull`` and ``response`` are its products with something else.
    """

    def __init__(self, left: Float32, warp: Warp) -> None:
        self.weights = weights = _Weights.of(warp.half)
        grey, smooth = (_windows(image, warp, 1).reshape(len(warp.centre_px), -1) for image in (left, _blurred(left)))
        self.clipped = np.count_nonzero((grey > 250) | (grey < 2), axis=1) / grey.shape[1]
        self.grey = weights.centred(grey)
        self.energy = _dots(self.grey, self.grey) + np.float32(1e-6)
        self._back = 0.5 * _back(warp)
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
        sums, along = patches @ slants[:, :1], _dots(self.grey, patches)[:, None]
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
        gain = np.minimum(np.maximum(_dots(patches, self.grey) / self.energy, 0.2), 5.0)[:, None]
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


def refine(left: Float32, right: Float32, warp: Warp, start_px: Array, limits: Limits | None = None) -> Matches:
    """Sub-pixel shifts from shifts good to a pixel or so, with the sigma that noise and texture imply."""
    if not len(start_px):
        return Matches(np.empty(0), np.empty(0), np.empty(0), np.empty(0, np.int8))
    templates, places, fine = _Templates(left, warp), _Places(warp, warp.half + 1, larger=2), doubled(right)
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
    template: _Templates,
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
    variance = _dots(residual, residual) / (width - 5)
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


def _parts(template: _Templates, residual: Float32, dense: Array) -> Array:
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
