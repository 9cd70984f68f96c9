"""The laser's green spot: looked for only where the beam can be seen, centred to a fraction of a pixel.

The beam's image is a known curve. Along it the green channel is compared with its own surroundings (a spot is small
and bright against them, a stain is not green, a glint is not on the curve); the centre is an iterated Gaussian-weighted
mean, which ignores what lies beyond the spot.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from leadline.samples import Array, Image

BAND_PX = 3.0  # off the curve: the rig's own error
MIN_SNR = 6.0
MIN_RISE = 6.0  # grey levels over the surroundings
CENTRE_ITERATIONS = 12


@dataclass(frozen=True, slots=True)
class Spot:
    """Centre (2,) px, covariance (2, 2) px^2, and how far it stands out of the noise along the curve."""

    q_px: Array
    cov_px2: Array
    snr: float


def find_spot(image: Image, curve_px: Array, radius_px: float) -> Spot | None:
    """The spot on a curve (K, 2) of an image, of about a given radius; None where nothing stands out.

    image: (H, W, 3) BGR or grey; curve: the beam's pixels where it may end, in order; NaN and outside ones are skipped.
    """
    margin = int(3 * radius_px + BAND_PX + 6)
    height, width = image.shape[:2]
    with np.errstate(invalid="ignore"):
        clear = ((curve_px > margin) & (curve_px < [width - margin - 1, height - margin - 1])).all(axis=1)
    curve = curve_px[clear]
    if len(curve) < 3:
        return None
    low = np.floor(curve.min(axis=0)).astype(int) - margin
    high = np.ceil(curve.max(axis=0)).astype(int) + margin + 1
    region = greenness(image[low[1] : high[1], low[0] : high[0]])
    rise = _rise(region, radius_px)
    strip = _across(rise, curve - low)
    row, column = divmod(int(np.argmax(strip)), strip.shape[1])
    peak = float(strip[row, column])
    noise = 1.4826 * float(np.median(np.abs(strip - np.median(strip)))) + 0.3
    if peak < MIN_RISE or peak < MIN_SNR * noise or _rival(strip, row, radius_px, peak):
        return None
    start = curve[row] - low + _normal(curve)[row] * (column - strip.shape[1] // 2)
    centred = centre_spot(region, start, radius_px)
    return None if centred is None else Spot(centred[0] + low, centred[1], peak / noise)


def greenness(image: Image) -> Array:
    """Green over the mean of red and blue, so that white glints and snow count half; grey images as they are."""
    if image.ndim == 2:
        return image.astype(float)
    blue, green, red = (image[..., i].astype(float) for i in range(3))
    return np.asarray(green - 0.25 * (blue + red))


def _rise(region: Array, radius_px: float) -> Array:
    """How far a spot-sized place stands above the ring around it."""
    inner = cv2.GaussianBlur(region, (0, 0), max(0.6 * radius_px, 0.8))
    outer = cv2.GaussianBlur(region, (0, 0), max(2.5 * radius_px, 3.0))
    return np.asarray(inner - outer)


def _normal(curve: Array) -> Array:
    tangent = np.gradient(curve, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True) + 1e-12
    return np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)


def _across(rise: Array, curve: Array) -> Array:
    """(K, M) of the rise along the curve and across it, a pixel apart."""
    t = np.arange(-BAND_PX, BAND_PX + 1)
    at = (curve[:, None] + t[None, :, None] * _normal(curve)[:, None]).astype(np.float32)
    return np.asarray(cv2.remap(rise.astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_LINEAR), float)


def _rival(strip: Array, best: int, radius_px: float, peak: float) -> bool:
    """Another place on the curve that stands out nearly as much: then neither is trusted."""
    apart = np.abs(np.arange(len(strip)) - best) > 8 * radius_px + 8
    return bool(apart.any() and strip[apart].max() > 0.7 * peak)


def centre_spot(region: Array, start: Array, radius_px: float) -> tuple[Array, Array] | None:
    """Iterated Gaussian-weighted mean over the background-free spot, and its covariance from the local noise."""
    reach = int(np.ceil(3 * radius_px)) + 3
    x0, y0 = (round(float(v)) for v in start)
    patch = region[y0 - reach : y0 + reach + 1, x0 - reach : x0 + reach + 1]
    if patch.shape != (2 * reach + 1, 2 * reach + 1):
        return None
    dy, dx = np.mgrid[-reach : reach + 1, -reach : reach + 1].astype(float)
    ring = np.hypot(dx, dy) > 2.2 * radius_px + 1
    terms = np.stack([np.ones_like(dx), dx, dy], axis=-1)
    plane = np.linalg.lstsq(terms[ring], patch[ring], rcond=None)[0]
    signal = patch - terms @ plane
    noise = float(np.std(signal[ring])) + 0.3
    width = max(radius_px, 1.0)
    centre = np.array([float(start[0]) - x0, float(start[1]) - y0])
    for _ in range(CENTRE_ITERATIONS):
        window = np.exp(-0.5 * ((dx - centre[0]) ** 2 + (dy - centre[1]) ** 2) / width**2)
        weight = window * signal
        total = float(weight.sum())
        if total <= 0:
            return None
        step = np.array([(weight * (dx - centre[0])).sum(), (weight * (dy - centre[1])).sum()]) / total
        centre = centre + 1.6 * step  # the window halves the step of a spot as wide as itself
        if np.linalg.norm(step) < 1e-3 or np.abs(centre).max() > reach:
            break
    if np.linalg.norm(centre - (start - [x0, y0])) > 2 * radius_px + 3:
        return None
    variance = 4 * noise**2 * float((window**2 * dx**2).sum()) / total**2
    return np.add(centre, [x0, y0]), (variance + 0.1**2) * np.eye(2)
