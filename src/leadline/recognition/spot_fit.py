"""The centre of a spot of light to a small part of a pixel, and how certain that is.

A Gaussian of free size and shape on a sloping ground is fitted to the pixels by least squares. What is saturated is
left out: the flanks tell the centre of a spot whose top is cut off. The colours are first mixed into one channel so
that the surface's own texture cancels as far as it has another colour than the spot (Fisher's discriminant).

How far texture and noise may have pulled the centre is measured, not assumed: the very same fit, linearised, is let
loose on the bare surface around the spot, and what it makes of that widens the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from leadline.samples import Array, Image

SATURATED = 245  # grey level; codecs put ripples of some levels on what was 255
REACH = 2.7  # half the fitted window, in expected sigmas
RING = 2.3  # beyond so many sigmas is bare ground
GLARE = 0.6  # a saturated spot shows farther out: both grow by this part of the saturated radius
SAMPLES = 2.5  # a larger spot is averaged until its sigma is about so many samples
MAX_STEPS = 12
SETTLED = 1e-2  # of a sigma: the last step leaves about its square
HELD, FREE_STEPS = 0.01, 2  # of the form: first held to what is expected, relative (1 sigma), then let go
LONGEST = np.array([0.7] * 5 + [np.inf] * 4)  # step, sigmas
SHAPE_SIGMA = 0.5  # how far size and roundness may differ from what is expected, relative
SUBSAMPLED_PX2 = 3.0  # video keeps colours at half the resolution: below this variance they help less

GRAIN = 2.0  # grey levels of noise taken for granted in the mean over a spot of 2 px sigma
FLOOR_PX = 0.01  # what no pixel tells: spots that are no Gaussians, codecs
CUT_OFF = 0.003  # and where the top is cut off, this part of a sigma the more, the farther out the flanks
CRAMPED = 10.0  # what is taken where there is no room to measure it
_MIN_PIXELS = 20


@dataclass(frozen=True, slots=True)
class SpotFit:
    """A fitted spot.

    q_px (2,) and cov_px2 (2, 2): the centre. shape_px2 (2, 2): covariance of its light. height (C,): over the ground,
    of each channel, grey levels. snr: height of the mixed channel over its own sigma. size, roundness: width against
    what was expected, and the narrower axis against the wider, where the expected spot has 1 and 1. misfit: the
    residual (RMS) against the height. spread: mean square distance from the centre of what fixed it, 1 for a whole
    spot, more for one whose top is cut off.
    """

    q_px: Array
    cov_px2: Array
    shape_px2: Array
    height: Array
    snr: float
    size: float
    roundness: float
    misfit: float
    spread: float


@dataclass(frozen=True, slots=True)
class _Window:
    """The pixels around a start, averaged block by block: the fitted window and its surroundings, thrice as wide."""

    values: Array  # (h, w, C) of the surroundings
    surface: Array  # (h, w) how they look themselves, in green light
    ring: float  # beyond so many sigmas is bare ground
    near: tuple[slice, slice]  # the fitted window in them
    clear: NDArray[np.intp]  # which samples of the fitted window are not saturated
    u: Array  # (2, n) places of the fitted window's samples: the expected spot is the unit circle


@dataclass(frozen=True, slots=True)
class _Solution:
    centre: Array  # (2,) in units of the expected sigma
    form: Array  # (2, 2) inverse covariance of the light there
    height: float
    terms: Array  # (9, n) d(model)/d(parameter)
    cov: Array  # (9, 9) as of white noise
    noise2: float  # its variance
    height_sigma: float  # for a known place and form
    residual: float  # RMS


def fit_spot(image: Image, start_px: Array, shape_px2: Array, dark: Image | None = None) -> SpotFit | None:
    """The spot near ``start_px`` (2,) of about the shape ``shape_px2`` (2, 2); None where the fit does not settle.

    image: (H, W, 3) BGR or (H, W) grey. dark: the same view without the laser, aligned; then the difference counts.
    """
    root = _root(shape_px2)
    start_px, glare = _glare(image, start_px, np.sqrt(np.diag(shape_px2)))
    window = _cut(image, dark, start_px, root, glare)
    if window is None:
        return None
    mixed = window.values @ _mix(window, float(root[0, 0] * root[1, 1]))
    u = window.u[:, window.clear]
    found = _solve(u, mixed[window.near].ravel()[window.clear], window.ring)
    if found is None:
        return None
    growth = _growth(mixed, window, found)
    spread = _spread(u, found)
    floor2 = FLOOR_PX**2 + (CUT_OFF * max(spread - 1.0, 0.0)) ** 2 * float(np.trace(shape_px2)) / 2
    to_px = root @ found.cov[:2, :2] @ root.T
    light = _inverse(found.form)
    narrow, wide = np.sqrt(_axes(light))
    return SpotFit(
        q_px=start_px + root @ found.centre,
        cov_px2=growth * to_px + floor2 * np.eye(2),
        shape_px2=root @ light @ root.T,
        height=_heights(window, found),
        snr=found.height / (found.height_sigma * float(np.sqrt(growth))),
        size=float(np.sqrt(narrow * wide)),
        roundness=float(narrow / wide),
        misfit=found.residual / abs(found.height),
        spread=spread,
    )


def _root(a: Array) -> Array:
    """Cholesky's factor of a (2, 2) matrix; by hand, as the next two: a call of the library's costs ten times more."""
    first = float(a[0, 0]) ** 0.5
    low = float(a[0, 1]) / first
    return np.array([[first, 0.0], [low, (float(a[1, 1]) - low * low) ** 0.5]])


def _inverse(a: Array) -> Array:
    (p, q), (r, s) = a.tolist()
    return np.asarray(np.array([[s, -q], [-r, p]]) / (p * s - q * r))


def _axes(a: Array) -> tuple[float, float]:
    """The eigenvalues of a symmetric (2, 2) matrix, the smaller one first."""
    (p, q), (_, s) = a.tolist()
    apart = float(np.hypot((p - s) / 2, q))
    return (p + s) / 2 - apart, (p + s) / 2 + apart


def _cut(image: Image, dark: Image | None, start_px: Array, root: Array, glare: float) -> _Window | None:
    """The window around a start, cut by the image's border; None where too little of it is left."""
    sigma = np.sqrt(np.einsum("ij,ij->i", root, root))
    block = max(1, int(float(np.sqrt(_axes(root @ root.T)[0])) / SAMPLES))
    half = np.ceil((REACH + glare) * sigma / block).astype(int) + 2 // block
    corner = np.round(start_px - (block - 1) / 2).astype(int)
    size = np.array([image.shape[1], image.shape[0]])
    low = np.maximum(-(3 * half + 1), -(corner // block))
    high = np.minimum(3 * half + 2, (size - corner) // block)
    half = np.minimum(half, np.minimum(-low, high - 1))  # even on both sides, or what is no Gaussian would pull
    near_low, near_high = -half, half + 1
    if (near_high - near_low < 5).any():
        return None
    part = tuple(slice(int(c + block * a), int(c + block * b)) for c, a, b in zip(corner, low, high, strict=True))[::-1]
    shape = tuple(int(n) for n in high - low)
    light = image[part]
    values = light if dark is None else light.astype(np.float32) - dark[part]
    values = np.asarray(_averaged(values, block, shape), np.float64).reshape(shape[1], shape[0], -1)
    surface = values[..., values.shape[2] // 2]
    if dark is not None:
        shown = dark[part] if dark.ndim == 2 else dark[part][..., 1]
        surface = np.asarray(_averaged(shown, block, shape), np.float64)
    near = tuple(slice(int(a - c), int(b - c)) for a, b, c in zip(near_low, near_high, low, strict=True))[::-1]
    full = tuple(slice(s.start * block, s.stop * block) for s in near)
    top = light[full] if light.ndim == 2 else light[full].max(axis=2)
    clipped = _averaged((top >= SATURATED).astype(np.float32), block, tuple(int(n) for n in near_high - near_low))
    clear = np.flatnonzero(clipped.ravel() <= 0)
    if len(clear) < _MIN_PIXELS:
        return None
    x, y = (
        c + block * np.arange(a, b) + (block - 1) / 2 - s
        for c, a, b, s in zip(corner, near_low, near_high, start_px, strict=True)
    )
    places = np.stack([np.broadcast_to(x, (len(y), len(x))).ravel(), np.repeat(y, len(x))])
    return _Window(values, surface, RING + glare, (near[0], near[1]), clear, _inverse(root) @ places)


def _glare(image: Image, start_px: Array, sigma: Array) -> tuple[Array, float]:
    """The middle of what is saturated around a start, and by how many sigmas such a spot shows farther out."""
    column, row = (int(v) for v in np.clip(np.round(start_px), 0, [image.shape[1] - 1, image.shape[0] - 1]))
    if image[row, column].max() < SATURATED:
        return start_px, 0.0
    reach = np.ceil(4 * sigma).astype(int)
    top, left = max(row - int(reach[1]), 0), max(column - int(reach[0]), 0)
    part = image[top : row + reach[1] + 1, left : column + reach[0] + 1]
    rows, columns = np.nonzero((part if part.ndim == 2 else part.max(axis=2)) >= SATURATED)
    middle = np.array([left + columns.mean(), top + rows.mean()])
    return middle, GLARE * min(float(np.sqrt(len(rows) / np.pi / (sigma[0] * sigma[1]))), 3.0)


def _averaged(values: NDArray[np.uint8 | np.float32], block: int, size: tuple[int, ...]) -> NDArray[np.float32]:
    if block == 1:
        return np.asarray(values, np.float32)
    return np.asarray(cv2.resize(np.asarray(values, np.float32), size, interpolation=cv2.INTER_AREA), np.float32)


def _mix(window: _Window, variance_px2: float) -> Array:
    """Weights (C,) of the channels in which the spot stands out best from the ground around it; green's is 1."""
    channels = window.values.shape[2]
    if channels == 1:
        return np.ones(1)
    values = window.values[window.near].reshape(-1, channels)
    r2 = np.einsum("in,in->n", window.u, window.u)
    ground = values[r2 > window.ring**2]
    middle = ground.mean(axis=0)
    off = ground - middle
    weight = np.exp(-0.5 * r2[window.clear])
    spot = weight @ (values[window.clear] - middle) / weight.sum()
    grain = GRAIN * 2 / max(variance_px2**0.5, 2.0)
    mix = np.linalg.solve(off.T @ off / len(off) + grain**2 * np.eye(channels), spot)
    if mix[1] <= 0:
        return np.array([0.0, 1.0, 0.0])
    mix /= mix[1]
    mix[[0, 2]] = np.clip(mix[[0, 2]], -2, 2) * variance_px2 / (variance_px2 + SUBSAMPLED_PX2)
    return np.asarray(mix)


def _solve(u: Array, values: Array, ring: float) -> _Solution | None:
    """Least squares by Gauss-Newton: the centre with the expected form, then the form that the light really has.

    A form that is held costs the centre nothing, and a top that is cut off cannot bend it.
    """
    terms = np.empty((9, len(values)))
    terms[6:] = 1.0
    terms[7:] = u
    theta = np.zeros(9)
    _evaluate(theta, u, terms)
    theta[5:] = np.linalg.solve(terms[5:] @ terms[5:].T, terms[5:] @ values)
    for _ in range(MAX_STEPS):
        step, normal, residual, variance = _step(theta, u, values, terms, HELD)
        theta += step
        if max(abs(theta[:2])) > 3:
            return None
        if max(abs(step[:2])) < SETTLED:
            break
    else:
        return None
    bare = residual[np.einsum("in,in->n", u, u) > ring**2]  # a top that is no Gaussian is not noise
    noise2 = float(bare @ bare) / len(bare) + 1e-3 if len(bare) >= _MIN_PIXELS else variance
    form, left = _form(theta, u, values, terms.copy())
    return _Solution(
        centre=theta[:2],
        form=form,
        height=float(theta[5]),
        terms=terms,
        cov=np.asarray(noise2 * np.linalg.inv(normal)),
        noise2=noise2,
        height_sigma=float(np.sqrt(noise2 / normal[5, 5])),
        residual=left,
    )


def _form(theta: Array, u: Array, values: Array, terms: Array) -> tuple[Array, float]:
    """Inverse covariance (2, 2) of the light, and what it leaves unexplained (RMS); a sliver where it is no spot."""
    free, variance = theta.copy(), np.inf
    for _ in range(FREE_STEPS):
        step, _, _, variance = _step(free, u, values, terms, SHAPE_SIGMA)
        free += step
        if not np.hypot(free[3], free[4]) < 0.95 * (1 + free[2]):
            return np.diag([1.0, 1e4]), float(np.sqrt(variance))
    form = np.array([[1 + free[2] + free[3], free[4]], [free[4], 1 + free[2] - free[3]]])
    return form, float(np.sqrt(variance))


def _step(theta: Array, u: Array, values: Array, terms: Array, form_sigma: float) -> tuple[Array, Array, Array, float]:
    """One step of centre (2), form (3), height and ground (3), with the normal matrix, the residual, its variance."""
    _evaluate(theta, u, terms)
    residual = values - theta[5:] @ terms[5:]
    variance = float(residual @ residual) / max(len(values) - 9, 5) + 1e-3
    normal = terms @ terms.T
    normal.ravel()[::10] += 1e-9
    hold = variance / form_sigma**2
    normal[[2, 3, 4], [2, 3, 4]] += hold
    pull = terms @ residual
    pull[2:5] -= hold * theta[2:5]
    step = np.linalg.solve(normal, pull)
    return np.clip(step, -LONGEST, LONGEST), normal, residual, variance


def _evaluate(theta: Array, u: Array, terms: Array) -> None:
    """The model's derivatives by its first six parameters, in place; terms[5] is the Gaussian itself."""
    x, y = u[0] - theta[0], u[1] - theta[1]
    by_x, by_y = (1 + theta[2] + theta[3]) * x + theta[4] * y, theta[4] * x + (1 + theta[2] - theta[3]) * y
    light = np.exp(-0.5 * (x * by_x + y * by_y))
    lit = theta[5] * light
    x2, y2 = x * x, y * y
    terms[0], terms[1] = lit * by_x, lit * by_y
    terms[2], terms[3], terms[4] = -0.5 * lit * (x2 + y2), -0.5 * lit * (x2 - y2), -lit * x * y
    terms[5] = light


def _heights(window: _Window, found: _Solution) -> Array:
    values = window.values[window.near].reshape(-1, window.values.shape[2])[window.clear]
    linear = found.terms[5:]
    return np.asarray(np.linalg.solve(linear @ linear.T, linear @ values)[0])


def _spread(u: Array, found: _Solution) -> float:
    pull = found.terms[0] ** 2 + found.terms[1] ** 2
    off = u - found.centre[:, None]
    return float(pull @ np.einsum("in,in->n", off, off) / pull.sum()) / 2


def _growth(mixed: Array, window: _Window, found: _Solution) -> float:
    """How much larger than white noise would make it the centre's variance is, by the bare surface around the spot."""
    influence = (found.cov @ found.terms)[:2] / found.noise2
    rows, columns = window.near
    height, width = rows.stop - rows.start, columns.stop - columns.start
    i = np.arange(rows.start % (height // 2), mixed.shape[0] - height + 1, height // 2)
    j = np.arange(columns.start % (width // 2), mixed.shape[1] - width + 1, width // 2)
    apart = (abs(i - rows.start)[:, None] >= height - 1) | (abs(j - columns.start) >= width - 1)  # not the spot itself
    place = (i[:, None] * mixed.shape[1] + j)[apart]
    within = window.clear // width * mixed.shape[1] + window.clear % width
    at = place[:, None] + within
    moved = mixed.ravel()[at] @ influence.T
    # Texture, less noise: it shades the spot's own light too.
    paint = np.asarray(cv2.GaussianBlur(window.surface, (7, 7), 1.5), np.float64)
    paint = paint / max(float(paint.mean()), 1.0) - 1
    moved += paint.ravel()[at] @ (found.height * influence * found.terms[5]).T
    ratios = np.einsum("ni,ij,nj->n", moved, _inverse(found.cov[:2, :2]), moved)
    if len(ratios) == 0:
        return CRAMPED
    limit = 6 * float(np.median(ratios)) + 1e-9  # an edge somewhere around is not under the spot
    return max(1.0, float(np.mean(np.minimum(ratios, limit))) / 2)
