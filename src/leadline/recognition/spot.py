"""The laser's green spot: looked for only where the beam can be seen, centred to a small part of a pixel.

The beam's image is a known curve, and the beam's length about known: what stands out along that piece of curve is a
candidate. A candidate is fitted (``spot_fit``) and must pass the gates: bright enough, green, of the spot's size, round
as the slanted surface makes it, on the line, and alone. What is turned away says why.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, floor, hypot, sqrt

import cv2
import numpy as np

from leadline.recognition.spot_fit import SpotFit, fit_spot
from leadline.samples import Array, Image

BAND_PX = 3.0  # off the curve: the rig's own error
MIN_RISE = 5.0  # grey levels over the ground
STANDS_OUT = 4.5  # over the noise along the curve, to be a candidate
MIN_SNR = 6.0  # of a fitted one
GREENER = 1.25  # than any other channel
SIZES = (0.45, 2.2)  # of what is expected
ROUNDNESS = 0.45
MISFIT = 0.35  # of its height
RIVAL = 0.6  # of the best one's height: then neither is trusted
CANDIDATES = 3
CENTRE_ITERATIONS = 12
_SEARCH_SIGMA = 1.2  # samples in a sigma while searching
_GREENNESS = np.array([[-0.25, 1.0, -0.25]])


@dataclass(frozen=True, slots=True)
class Spot:
    """Centre (2,) px, covariance (2, 2) px^2, how far it stands out of the noise, and ``SpotFit.spread``."""

    q_px: Array
    cov_px2: Array
    snr: float
    spread: float = 1.0


@dataclass(frozen=True, slots=True)
class NoSpot:
    """Why there is none, in plain words."""

    reason: str


def find_spot(
    image: Image,
    curve_px: Array,
    shape_px2: Array,
    beam_px_m: Array | None = None,
    dark: Image | None = None,
) -> Spot | NoSpot:
    """The spot on a curve (K, 2) of an image, of about the shape (2, 2) px^2 (covariance of its light).

    image: (H, W, 3) BGR or (H, W) grey. curve: the beam's pixels where it may end, in order; NaN and outside ones are
    skipped. beam_px_m: (2,) how far the beam's image runs in a metre of it, there; without, the water is taken as so
    clear that the beam does not glow. dark: the same view without the laser (a pulsed laser's other frame), aligned to
    the image: then only what the laser added counts.
    """
    sigma_px = sqrt(float(shape_px2[0, 0] + shape_px2[1, 1]) / 2)
    x, y = curve_px[:, 0], curve_px[:, 1]
    right, bottom = image.shape[1] - 1 - sigma_px, image.shape[0] - 1 - sigma_px
    curve = curve_px[(x > sigma_px) & (x < right) & (y > sigma_px) & (y < bottom)]
    if len(curve) < 3:
        return NoSpot("the beam's end is out of the picture")
    places = _candidates(image, dark, curve, sigma_px)
    if not places:
        return NoSpot("nothing stands out along the beam")
    found: list[SpotFit] = []
    reasons: list[str] = []
    best = places[0][0]
    for rise, q_px in places:
        if rise < RIVAL * best and found:
            break
        fit = fit_spot(image, q_px, shape_px2, beam_px_m, dark)
        reason = "no spot fits what stands out" if fit is None else _refused(fit, curve, image.shape)
        if fit is not None and not reason:
            found.append(fit)
        else:
            reasons.append(reason)
    if not found:
        return NoSpot(reasons[0])
    strongest = max(found, key=lambda fit: fit.height.max())
    if any(fit is not strongest and fit.height.max() > RIVAL * strongest.height.max() for fit in found):
        return NoSpot("two places on the beam look like its spot")
    return Spot(strongest.q_px, strongest.cov_px2, strongest.snr, strongest.spread)


def greenness(image: Image) -> Array:
    """Green over the mean of red and blue, so that white glints and snow count half; grey images as they are."""
    if image.ndim == 2:
        return image.astype(float)
    blue, green, red = (image[..., i].astype(float) for i in range(3))
    return np.asarray(green - 0.25 * (blue + red))


def _refused(fit: SpotFit, curve: Array, shape: tuple[int, ...]) -> str:
    """The gate that a fitted candidate fails, in plain words; '' where it passes all."""
    beside = BAND_PX + 3 * sqrt(float(fit.cov_px2[0, 0] + fit.cov_px2[1, 1]))
    others = fit.height[[0, 2]].max() if len(fit.height) == 3 else 0.0
    gates = {
        "what stands out is too faint": fit.snr > MIN_SNR and fit.height.max() > MIN_RISE,
        "what stands out is not green: a glint, a lamp or a particle": fit.height[len(fit.height) // 2]
        > GREENER * others,
        "what stands out is too small for the spot": fit.size > SIZES[0],
        "what stands out is too large for the spot": fit.size < SIZES[1],
        "what stands out is not round": fit.roundness > ROUNDNESS,
        "what stands out has another profile than a spot": fit.misfit < MISFIT,
        "what stands out is cut by the picture's border": _inside(fit.q_px, shape),
        "what stands out is beside the beam": _aside(fit.q_px, curve) < beside,
    }
    return next((reason for reason, passed in gates.items() if not passed), "")


def _inside(q_px: Array, shape: tuple[int, ...]) -> bool:
    x, y = q_px.tolist()
    return bool(0 <= x <= shape[1] - 1 and 0 <= y <= shape[0] - 1)


def _aside(q_px: Array, curve: Array) -> float:
    """How far a pixel (2,) lies beside a curve."""
    off = q_px - curve
    nearest = int(np.argmin(off[:, 0] ** 2 + off[:, 1] ** 2))
    middle = min(max(nearest, 1), len(curve) - 2)
    (x, y), (along_x, along_y) = off[nearest].tolist(), (curve[middle + 1] - curve[middle - 1]).tolist()
    return float(abs(along_x * y - along_y * x) / (hypot(along_x, along_y) + 1e-12))


def _candidates(image: Image, dark: Image | None, curve: Array, sigma_px: float) -> list[tuple[float, Array]]:
    """(rise, pixel (2,)) of what stands out along the curve, the highest first."""
    block = max(1, int(sigma_px / _SEARCH_SIGMA))
    margin = 4 * sigma_px + BAND_PX + 2
    (left, top), (right, bottom) = curve.min(axis=0).tolist(), curve.max(axis=0).tolist()
    x0, y0 = max(floor(left - margin), 0), max(floor(top - margin), 0)
    width = (min(ceil(right + margin) + 1, image.shape[1]) - x0) // block
    height = (min(ceil(bottom + margin) + 1, image.shape[0]) - y0) // block
    size = width, height
    part = np.s_[y0 : y0 + height * block, x0 : x0 + width * block]
    green = _small(image[part], size, block)
    if dark is not None:
        green = green - _small(dark[part], size, block)
    sigma = max(sigma_px / block, 0.7)
    side = 2 * round(3 * sigma) + 1
    rise = cv2.GaussianBlur(green, (0, 0), 0.8 * sigma) - cv2.blur(green, (side, side))
    step = max(1, round(0.5 * sigma_px / max(hypot(*(curve[1] - curve[0]).tolist()), 0.1)))
    line = curve[::step]
    beside = ceil(BAND_PX / block)
    across = np.arange(-beside, beside + 1, dtype=np.float64) * block
    at = line[:, None] + across[None, :, None] * _normals(line)[:, None]
    place = np.asarray((at - (np.array([x0, y0]) + (block - 1) / 2)) / block, np.float32)
    strip = cv2.remap(rise, place[..., 0], place[..., 1], cv2.INTER_LINEAR)
    return _peaks(np.asarray(strip, np.float64), at, sigma_px)


def _peaks(strip: Array, at: Array, sigma_px: float) -> list[tuple[float, Array]]:
    top = strip.max(axis=1)
    half = strip.size // 2
    middle = float(np.partition(strip.ravel(), half)[half])
    noise = 1.4826 * float(np.partition(np.abs(strip - middle).ravel(), half)[half]) + 0.2
    found: list[tuple[float, Array]] = []
    left = top.copy()
    while len(found) < CANDIDATES:
        row = int(np.argmax(left))
        peak = float(left[row])
        if peak < max(STANDS_OUT * noise, 0.4 * MIN_RISE):
            break
        q_px = at[row, int(np.argmax(strip[row]))]
        found.append((peak, q_px))
        left[np.hypot(*(at[:, at.shape[1] // 2] - q_px).T) < 4 * sigma_px + 2] = -np.inf
    return found


def _small(part: Image, size: tuple[int, int], block: int) -> Array:
    """Greenness, float32, averaged over blocks."""
    if block > 1:
        part = np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA), np.uint8)
    if part.ndim == 2:
        return np.asarray(part, np.float32)
    return np.asarray(cv2.transform(part.astype(np.float32), _GREENNESS), np.float32)


def _normals(curve: Array) -> Array:
    """Unit normals (K, 2) of a curve."""
    normal = np.empty_like(curve)
    normal[1:-1] = curve[2:] - curve[:-2]
    normal[0], normal[-1] = curve[1] - curve[0], curve[-1] - curve[-2]
    normal /= np.hypot(normal[:, :1], normal[:, 1:]) + 1e-12
    normal = normal[:, ::-1]
    normal[:, 0] *= -1
    return normal


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
