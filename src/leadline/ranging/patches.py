"""Least-squares matching of patches between the two images, along given directions, with slant and brightness.

A patch is a square of the left image; a warp says where its pixels are expected in the right one. The right place is
found by a shift along the epipolar direction that may vary linearly over the patch (slant), with gain and offset of
brightness free (Gruen 1985, "Adaptive least squares correlation"). All patches are solved together, vectorised.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from leadline.ranging.images import Float32, Spline
from leadline.samples import Array

MAX_ITERATIONS = 5
MAX_STEP_PX = 0.7
SETTLED_PX = 3e-3
MAX_RUN_PX = 2.0  # from the whole-pixel search, which cannot be wrong by more
MAX_SLANT_PX = 4.0
MIN_SIGNAL = 0.2  # texture that both images share, over texture and noise of one


@dataclass(frozen=True, slots=True)
class Warp:
    """Where patches are expected in the right image. N patches of (2 half + 1)^2 pixels."""

    centre_px: Array  # (N, 2) integers, left
    half: int
    expected_px: Array  # (N, 2) right
    bend: Array  # (N, 2, 5) right pixels for dx, dy, dx^2, dx dy, dy^2: tilt, curvature and refraction of the surface
    along: Array  # (N, 2) unit direction of the epipolar curve, right


@dataclass(frozen=True, slots=True)
class Matches:
    """Shift (N,) along the direction, its sigma (N,), and the correlation (N,); NaN where there is none."""

    shift_px: Array
    sigma_px: Array
    correlation: Array


def templates(left: Float32, warp: Warp) -> tuple[Array, Array, Array]:
    """Patch pixels (N, W) of the left image and their x, y derivatives (Gaussian, sigma 1 px)."""
    offset = np.arange(-warp.half, warp.half + 1)
    rows = warp.centre_px[:, 1, None, None].astype(int) + offset[None, :, None]
    columns = warp.centre_px[:, 0, None, None].astype(int) + offset[None, None, :]
    low = np.array([columns.min(), rows.min()]) - 6
    high = np.array([columns.max(), rows.max()]) + 7
    low = np.maximum(low, 0)
    region = np.ascontiguousarray(left[low[1] : high[1], low[0] : high[0]])
    smooth = cv2.getGaussianKernel(9, 1.0, cv2.CV_32F)
    slope = smooth * np.arange(-4, 5, dtype=np.float32)[:, None]
    slope /= float((slope[:, 0] * np.arange(-4, 5)).sum())
    gx = cv2.sepFilter2D(region, cv2.CV_32F, slope, smooth)
    gy = cv2.sepFilter2D(region, cv2.CV_32F, smooth, slope)
    at = (rows - low[1], columns - low[0])
    flat = (len(warp.centre_px), -1)
    return tuple(np.asarray(image[at].reshape(flat), float) for image in (region, gx, gy))  # type: ignore[return-value]


def offsets(half: int) -> tuple[Array, Array]:
    """(W,) dx, dy of a patch's pixels from its centre, rows first."""
    dy, dx = np.mgrid[-half : half + 1, -half : half + 1]
    return dx.ravel().astype(float), dy.ravel().astype(float)


def places(warp: Warp, shift_px: Array, slant: Array) -> tuple[Array, Array]:
    """Right coordinates (N, W) of every patch pixel for shifts (N,) and slants (N, 2) in px at the patch's edge."""
    dx, dy = offsets(warp.half)
    along = shift_px[:, None] + (slant[:, :1] * dx + slant[:, 1:] * dy) / warp.half
    x, y = (warp.bend @ bend_terms(dx, dy)).transpose(1, 0, 2)
    return (
        warp.expected_px[:, :1] + x + along * warp.along[:, :1],
        warp.expected_px[:, 1:] + y + along * warp.along[:, 1:],
    )


def bend_terms(dx: Array, dy: Array) -> Array:
    """(5, W) what ``Warp.bend`` multiplies."""
    return np.stack([dx, dy, dx * dx, dx * dy, dy * dy])


def search(left: Float32, right: Float32, warp: Warp, reach_px: float) -> tuple[Array, Array]:
    """The best whole-pixel shift (N,) within +-reach, and the correlation there (N,)."""
    template = _normalised(templates(left, warp)[0])
    shifts = np.arange(-np.ceil(reach_px), np.ceil(reach_px) + 1)
    flat = np.zeros((len(template), 2))
    scores = []
    for shift in shifts:
        x, y = places(warp, np.full(len(template), shift), flat)
        sampled = cv2.remap(
            right, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        scores.append(np.einsum("nw,nw->n", template, _normalised(np.asarray(sampled, float))))
    table = np.array(scores)
    best = table.argmax(axis=0)
    return shifts[best], table[best, np.arange(len(best))]


def _normalised(patches: Array) -> Array:
    centred = patches - patches.mean(axis=1, keepdims=True)
    return np.asarray(centred / (np.linalg.norm(centred, axis=1, keepdims=True) + 1e-9))


def refine(left: Float32, right: Float32, warp: Warp, start_px: Array) -> Matches:
    """Sub-pixel shifts from whole-pixel ones, with the sigma that the patch's own noise and texture imply.

    The smooth derivative of the left patch is an instrument, its response is measured in the right patch: their noises
    are independent, so that noise neither counts as texture nor slows the steps, and fine texture is not overshot.
    """
    template, gx, gy = templates(left, warp)
    instrument = _design(warp, gx, gy, template)
    x, y = places(warp, start_px, np.zeros((len(start_px), 2)))
    spline = Spline.of(right, np.stack([x.ravel(), y.ravel()], axis=1), 8 + warp.half)
    p = np.concatenate([start_px[:, None], np.zeros((len(start_px), 2))], axis=1)
    residual, response = np.zeros_like(template), np.zeros((len(p), 5, 5))
    for _ in range(MAX_ITERATIONS):
        sampled = spline.sample(*places(warp, p[:, 0], p[:, 1:])).astype(float)  # NaN: the patch left the image
        gain, level = _brightness(template, sampled)
        matched = (sampled - level[:, None]) / gain[:, None]
        residual = matched - template
        response = instrument.transpose(0, 2, 1) @ _design(warp, *_slopes(matched, warp.half), template)
        pull = (residual[:, None] @ instrument)[:, 0]
        step = -(np.linalg.pinv(np.nan_to_num(response)) @ pull[:, :, None])[:, :3, 0]
        step = np.clip(step, -MAX_STEP_PX, MAX_STEP_PX)
        p = p + step
        if not np.nanmax(np.abs(step), initial=0.0) >= SETTLED_PX:
            break
    return _judge(template, residual, instrument, response, p, start_px)


def _design(warp: Warp, gx: Array, gy: Array, template: Array) -> Array:
    """Derivatives (N, W, 5) of a patch by shift, the two slants, gain and level."""
    back = np.linalg.inv(warp.bend[:, :, :2]) @ warp.along[:, :, None]
    slope = gx * back[:, 0] + gy * back[:, 1]  # for a step along the epipolar direction of the right image
    dx, dy = offsets(warp.half)
    centred = template - template.mean(axis=1, keepdims=True)
    return np.stack([slope, slope * dx / warp.half, slope * dy / warp.half, centred, np.ones_like(template)], axis=2)


def _slopes(patches: Array, half: int) -> tuple[Array, Array]:
    """x, y derivatives (N, W) of patches, by differences of the fourth order."""
    side = 2 * half + 1
    square = np.pad(patches.reshape(-1, side, side), ((0, 0), (2, 2), (2, 2)), mode="edge")
    inner = slice(2, -2)

    def difference(axis: int) -> Array:
        def moved(by: int) -> Array:
            index = [slice(None), inner, inner]
            index[axis] = slice(2 + by, by - 2 or None)
            return np.asarray(square[tuple(index)])

        return ((8 * (moved(1) - moved(-1)) - (moved(2) - moved(-2))) / 12).reshape(patches.shape)

    return difference(2), difference(1)


def _brightness(template: Array, sampled: Array) -> tuple[Array, Array]:
    """Gain and level that take the template to the sampled patch (N,)."""
    t = template - template.mean(axis=1, keepdims=True)
    s = sampled - sampled.mean(axis=1, keepdims=True)
    gain = np.clip(np.einsum("nw,nw->n", t, s) / (np.einsum("nw,nw->n", t, t) + 1e-9), 0.2, 5.0)
    return gain, sampled.mean(axis=1) - gain * template.mean(axis=1)


def _judge(template: Array, residual: Array, instrument: Array, response: Array, p: Array, start_px: Array) -> Matches:
    """Sigma of the shift by the sandwich rule, and NaN for what ran away, left the image or has no texture."""
    noise = np.einsum("nw,nw->n", residual, residual) / (template.shape[1] - 5)  # of left and right together
    spread = instrument.transpose(0, 2, 1) @ instrument
    weak = ~(response[:, 0, 0] > MIN_SIGNAL * spread[:, 0, 0])
    inverse = np.linalg.pinv(np.where(weak[:, None, None], np.eye(5), response))
    variance = noise * np.einsum("ni,nij,nj->n", inverse[:, 0], spread, inverse[:, 0])
    correlation = np.sqrt(np.clip(1 - noise / (template.var(axis=1) + noise + 1e-9), 0, 1))
    lost = weak | ~np.isfinite(variance) | (np.abs(p[:, 0] - start_px) > MAX_RUN_PX)
    lost |= np.abs(p[:, 1:]).max(axis=1) > MAX_SLANT_PX
    shift = np.where(lost, np.nan, p[:, 0])
    return Matches(shift, np.where(lost, np.nan, np.sqrt(np.abs(variance))), correlation)
