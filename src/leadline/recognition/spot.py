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
        if found and (rise < RIVAL * best or any(_apart(fit.q_px, q_px) < _alone_px(sigma_px) for fit in found)):
            continue  # too faint to matter, or the rim of a saturated one
        fit = fit_spot(image, q_px, shape_px2, beam_px_m, dark)
        reason = "no spot fits what stands out" if fit is None else _refused(fit, curve, image.shape)
        if fit is not None and not reason:
            found.append(fit)
        else:
            reasons.append(reason)
    if not found:
        return NoSpot(reasons[0])
    strongest = max(found, key=lambda fit: fit.height.max())
    for fit in found:
        if fit.height.max() > RIVAL * strongest.height.max() and _apart(fit.q_px, strongest.q_px) > sigma_px:
            return NoSpot("two places on the beam look like its spot")
    return Spot(strongest.q_px, strongest.cov_px2, strongest.snr, strongest.spread)


def _apart(one_px: Array, other_px: Array) -> float:
    return hypot(*(one_px - other_px).tolist())


def _alone_px(sigma_px: float) -> float:
    """Two places nearer than this to each other are not told apart."""
    return 4 * sigma_px + 2


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
    line, normal = _thinned(curve, 0.5 * sigma_px)
    across = np.arange(-ceil(BAND_PX / block), ceil(BAND_PX / block) + 1, dtype=np.float64) * block
    at = line[:, None] + across[:, None] * normal
    place = np.asarray((at - np.array([x0 + (block - 1) / 2, y0 + (block - 1) / 2])) / block, np.float32)
    strip = cv2.remap(rise, place[..., 0], place[..., 1], cv2.INTER_LINEAR)
    return _peaks(np.asarray(strip, np.float64), at, sigma_px)


def _thinned(curve: Array, step_px: float) -> tuple[Array, Array]:
    """About a point each step, and the unit normal (2,); a beam's image is as good as straight."""
    x, y = (curve[-1] - curve[0]).tolist()
    length = hypot(x, y) + 1e-12
    return curve[:: max(1, round(step_px * (len(curve) - 1) / length))], np.array([-y / length, x / length])


def _peaks(strip: Array, at: Array, sigma_px: float) -> list[tuple[float, Array]]:
    """The highest places of a strip (K, n) with pixels ``at`` (K, n, 2), apart from each other."""
    half = strip.size // 2
    middle = float(np.partition(strip.ravel(), half)[half])
    noise = 1.4826 * float(np.partition(np.abs(strip - middle).ravel(), half)[half]) + 0.2
    least = max(STANDS_OUT * noise, 0.4 * MIN_RISE)
    found: list[tuple[float, Array]] = []
    while len(found) < CANDIDATES:
        row, column = divmod(int(strip.argmax()), strip.shape[1])
        if strip[row, column] < least:
            break
        q_px = at[row, column]
        found.append((float(strip[row, column]), q_px))
        off = at[:, at.shape[1] // 2] - q_px
        off *= off
        strip[off[:, 0] + off[:, 1] < _alone_px(sigma_px) ** 2] = -np.inf
    return found


def _small(part: Image, size: tuple[int, int], block: int) -> Array:
    """Greenness, float32, averaged over blocks."""
    if block > 1:
        part = np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA), np.uint8)
    if part.ndim == 2:
        return np.asarray(part, np.float32)
    return np.asarray(cv2.transform(part.astype(np.float32), _GREENNESS), np.float32)
