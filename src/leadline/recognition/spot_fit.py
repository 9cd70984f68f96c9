"""The centre of a spot of light to a small part of a pixel, and how certain that is.

A Gaussian of free size and shape on a sloping ground is fitted to the pixels by least squares. What is saturated is
left out: the flanks tell the centre of a spot whose top is cut off. The colours are first mixed into one channel so
that the surface's own texture cancels as far as it has another colour than the spot (Fisher's discriminant).

How far texture and noise may have pulled the centre is measured, not assumed: the very same fit, linearised, is let
loose on the bare surface around the spot, and what it makes of that widens the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, exp, hypot, pi

import cv2
import numpy as np
from numpy.typing import NDArray

from leadline.recognition.spot_model import CENTRE, GLOW, HEIGHT, Beamed, Normal, blank, heights, solved
from leadline.samples import Array, Image

SATURATED = 245  # grey level; codecs put ripples of some levels on what was 255
REACH = 2.7  # half the fitted window, in expected sigmas
RING = 2.3  # beyond so many sigmas is bare ground
GLARE = 0.6  # a saturated spot shows farther out: both grow by this part of the saturated radius
SAMPLES = 2.5  # a larger spot is averaged until its sigma is about so many samples
MAX_STEPS = 12
SETTLED = 1e-2  # of a sigma: the last step leaves about its square
HELD = 0.01  # of the form: first held to what is expected, relative (1 sigma), then let go
BLUR_PX2 = 0.3  # but nobody knows how sharp lens, water and pixels are: the variance of their blur, 1 sigma
SHAPE_SIGMA = 0.5  # how far size and roundness may differ from what is expected, relative
SUBSAMPLED_PX2 = 3.0  # video keeps colours at half the resolution: below this variance they help less

GRAIN = 2.0  # grey levels of noise taken for granted in the mean over a spot of 2 px sigma
FLOOR_PX = 0.01  # what no pixel tells: spots that are no Gaussians, codecs
CUT_OFF = 0.003  # and where the top is cut off, this part of a sigma the more, the farther out the flanks
GRID_PX = 0.2  # and what falls between the pixels: times exp(-(pi sigma)^2), for spots with a sigma below 0.6 px
BEAM_END = 0.2  # how a beam ends on a surface is known to this part of a sigma, times how much it glows of the spot
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
    inner: Array  # (m, C) its samples
    r2: Array  # (m,) their square distance from the start: the expected spot is the unit circle
    clear: NDArray[np.intp]  # (n,) which of them are not saturated
    u: Array  # (2, n) the places of those


@dataclass(frozen=True, slots=True)
class _Solution:
    centre: Array  # (2,) in units of the expected sigma
    form: Array  # (2, 2) inverse covariance of the light there
    height: float
    glow: float
    terms: Array  # (m, n) d(model)/d(parameter)
    cov: Array  # (m, m) as of white noise
    noise2: float  # its variance
    height_sigma: float  # for a known place and form
    residual: float  # RMS


def fit_spot(
    image: Image, start_px: Array, shape_px2: Array, beam_px_m: Array | None = None, dark: Image | None = None
) -> SpotFit | None:
    """The spot near ``start_px`` (2,) of about the shape ``shape_px2`` (2, 2); None where the fit does not settle.

    image: (H, W, 3) BGR or (H, W) grey. beam_px_m: (2,) how far the beam's image runs in a metre of it, away from the
    laser; without, no glow is fitted. dark: the same view without the laser, aligned; then the difference counts.
    """
    root = _root(shape_px2)
    start_px, glare = _glare(image, start_px, np.sqrt(shape_px2.diagonal()))
    window = _cut(image, dark, start_px, shape_px2, root, glare)
    if window is None:
        return None
    clear = window.inner.take(window.clear, axis=0)
    mix = _mix(window, clear, float(root[0, 0] * root[1, 1]))
    beam = None if beam_px_m is None else Beamed.of(solved(root, beam_px_m))
    held = max(HELD, BLUR_PX2 / float(root[0, 0] * root[1, 1]))
    found = _solve(window, clear @ mix, beam, held)
    if found is None:
        return None
    growth = _growth(window, mix, found)
    light = _inverse(found.form)
    narrow, wide = np.sqrt(_axes(light))
    spread = _spread(window.u, found)
    to_px = root @ found.cov[:2, :2] @ root.T
    return SpotFit(
        q_px=start_px + root @ found.centre,
        cov_px2=growth * to_px + _unseen(shape_px2, float(narrow * wide), spread, found, beam_px_m),
        shape_px2=root @ light @ root.T,
        height=heights(clear, found.terms[HEIGHT:]),
        snr=found.height / (found.height_sigma * float(np.sqrt(growth))),
        size=float(np.sqrt(narrow * wide)),
        roundness=float(narrow / wide),
        misfit=found.residual / abs(found.height),
        spread=spread,
    )


def _unseen(shape_px2: Array, size2: float, spread: float, found: _Solution, beam_px_m: Array | None) -> Array:
    """Covariance (2, 2) px^2 of what no pixel tells."""
    variance = float(np.trace(shape_px2)) / 2
    grid = GRID_PX * exp(-(pi**2) * min(size2, 4.0) * variance)
    floor2 = FLOOR_PX**2 + grid**2 + (CUT_OFF * max(spread - 1.0, 0.0)) ** 2 * variance
    unseen = floor2 * np.eye(2)
    if beam_px_m is not None:
        back = beam_px_m / hypot(*beam_px_m.tolist())
        pull = BEAM_END * found.glow / max(found.height, 1.0)
        unseen += pull**2 * float(back @ shape_px2 @ back) * np.outer(back, back)
    return np.asarray(unseen)


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
    apart = hypot((p - s) / 2, q)
    return (p + s) / 2 - apart, (p + s) / 2 + apart


def _cut(
    image: Image, dark: Image | None, start_px: Array, shape_px2: Array, root: Array, glare: float
) -> _Window | None:
    """The window around a start, cut by the image's border; None where too little of it is left."""
    block = max(1, int(_axes(shape_px2)[0] ** 0.5 / SAMPLES))
    (first, _), (low, second) = root.tolist()
    reach = (REACH + glare) * first, (REACH + glare) * hypot(low, second)
    x, y = (_Span.of(float(start_px[i]), reach[i], image.shape[1 - i], block) for i in (0, 1))
    if min(x.half, y.half) < 2:
        return None
    part, near, full = (y.part, x.part), (y.near, x.near), (y.full, x.full)
    shape = x.high - x.low, y.high - y.low
    light = image[part]
    values = _averaged(light if dark is None else light.astype(np.float32) - dark[part], block, shape)
    values = values.reshape(shape[1], shape[0], -1)
    surface = values[..., values.shape[2] // 2]
    if dark is not None:
        surface = _averaged(dark[part] if dark.ndim == 2 else dark[part][..., 1], block, shape)
    size = 2 * x.half + 1, 2 * y.half + 1
    clear = np.arange(size[0] * size[1])
    if light[full].max() >= SATURATED:
        clipped = _averaged((_brightest(light[full]) >= SATURATED).astype(np.float32), block, size)
        clear = np.flatnonzero(clipped.ravel() <= 0)
    if len(clear) < _MIN_PIXELS:
        return None
    grid = np.empty((2, size[1], size[0]))
    grid[0] = x.places / first
    grid[1] = (y.places[:, None] - low * grid[0]) / second
    u = grid.reshape(2, -1)
    r2 = u[0] * u[0] + u[1] * u[1]
    inner = values[near].reshape(-1, values.shape[2])
    return _Window(values, surface, RING + glare, near, inner, r2, clear, u.take(clear, axis=1))


@dataclass(frozen=True, slots=True)
class _Span:
    """One axis of a window: in blocks from its start, the surroundings [low, high) and the fitted [-half, half]."""

    start_px: float
    corner: int
    block: int
    half: int
    low: int
    high: int

    @classmethod
    def of(cls, start_px: float, reach_px: float, size: int, block: int) -> _Span:
        half = ceil(reach_px / block) + 2 // block
        corner = round(start_px - (block - 1) / 2)
        low = max(-(3 * half + 1), -(corner // block))
        high = min(3 * half + 2, (size - corner) // block)
        half = min(half, -low, high - 1)  # even on both sides, or what is no Gaussian would pull
        return cls(start_px, corner, block, half, low, high)

    @property
    def part(self) -> slice:
        """Of the image: the surroundings."""
        return slice(self.corner + self.block * self.low, self.corner + self.block * self.high)

    @property
    def near(self) -> slice:
        """Of the surroundings: the fitted window, in blocks."""
        return slice(-self.half - self.low, self.half + 1 - self.low)

    @property
    def full(self) -> slice:
        """The same in pixels."""
        return slice(self.near.start * self.block, self.near.stop * self.block)

    @property
    def places(self) -> Array:
        """Pixels from the start to the middles of the fitted window's blocks."""
        middle = self.corner + (self.block - 1) / 2 - self.start_px
        return np.arange(-self.half, self.half + 1, dtype=np.float64) * self.block + middle


def _glare(image: Image, start_px: Array, sigma: Array) -> tuple[Array, float]:
    """The middle of what is saturated around a start, and by how many sigmas such a spot shows farther out."""
    column, row = (int(v) for v in np.clip(np.round(start_px), 0, [image.shape[1] - 1, image.shape[0] - 1]))
    if image[row, column].max() < SATURATED:
        return start_px, 0.0
    reach = np.ceil(4 * sigma).astype(int)
    top, left = max(row - int(reach[1]), 0), max(column - int(reach[0]), 0)
    part = image[top : row + reach[1] + 1, left : column + reach[0] + 1]
    rows, columns = np.nonzero(_brightest(part) >= SATURATED)
    middle = np.array([left + columns.mean(), top + rows.mean()])
    return middle, GLARE * min(float(np.sqrt(len(rows) / np.pi / (sigma[0] * sigma[1]))), 3.0)


def _brightest(image: Image) -> Image:
    """(H, W) the largest of a pixel's channels."""
    return image if image.ndim == 2 else np.maximum(np.maximum(image[..., 0], image[..., 1]), image[..., 2])


def _averaged(values: NDArray[np.uint8 | np.float32], block: int, size: tuple[int, int]) -> Array:
    if block == 1:
        return np.asarray(values, np.float64)
    resized = cv2.resize(np.asarray(values, np.float32), size, interpolation=cv2.INTER_AREA)
    return np.asarray(resized, np.float64)


def _mix(window: _Window, clear: Array, variance_px2: float) -> Array:
    """Weights (C,) of the channels in which the spot stands out best from the ground around it; green's is 1."""
    channels = window.values.shape[2]
    if channels == 1:
        return np.ones(1)
    ground = window.inner.take(np.flatnonzero(window.r2 > window.ring**2), axis=0)
    middle = np.ones(len(ground)) @ ground / len(ground)
    off = ground - middle
    weight = np.exp(-0.5 * window.r2.take(window.clear))
    spot = weight @ clear / weight.sum() - middle
    grain = GRAIN * 2 / max(variance_px2**0.5, 2.0)
    mix = solved(off.T @ off / len(off) + grain**2 * np.eye(channels), spot)
    if mix[1] <= 0:
        return np.array([0.0, 1.0, 0.0])
    mix /= mix[1]
    mix[[0, 2]] = np.clip(mix[[0, 2]], -2, 2) * variance_px2 / (variance_px2 + SUBSAMPLED_PX2)
    return np.asarray(mix)


def _solve(window: _Window, values: Array, beam: Beamed | None, held: float) -> _Solution | None:
    """Least squares by Gauss-Newton: the centre with about the expected form, then the form that the light really has.

    A form that is held costs the centre nothing, and a top that is cut off cannot bend it.
    """
    u, r2 = window.u, window.r2.take(window.clear)
    terms = blank(u, r2, beam)
    theta = np.zeros(len(terms))
    theta[HEIGHT:GLOW] = heights(values, terms[HEIGHT:GLOW])
    last = np.zeros(2)
    for _ in range(MAX_STEPS):
        here = Normal.at(theta, u, values, terms, beam)
        step, normal = here.step(held)
        settled = max(abs(step[CENTRE])) < SETTLED
        if not settled and float(step[CENTRE] @ last) < 0:
            step *= 0.5  # to and fro between two pixels
        theta, last = theta + step, step[CENTRE]
        if max(abs(theta[CENTRE])) > 3:
            return None
        if settled:
            break
    else:
        return None
    bare = here.residual[r2 > window.ring**2]  # a top that is no Gaussian is not noise
    noise2 = float(bare @ bare) / len(bare) + 1e-3 if len(bare) >= _MIN_PIXELS else here.variance
    form, left = _form(here, u, values, terms.copy())
    return _Solution(
        centre=theta[CENTRE],
        form=form,
        height=float(theta[HEIGHT]),
        glow=0.0 if beam is None else max(float(theta[GLOW]), 0.0),
        terms=terms,
        cov=np.asarray(noise2 * cv2.invert(normal)[1]),
        noise2=noise2,
        height_sigma=float(np.sqrt(noise2 / normal[HEIGHT, HEIGHT])),
        residual=left,
    )


def _form(here: Normal, u: Array, values: Array, terms: Array) -> tuple[Array, float]:
    """Inverse covariance (2, 2) of the light, and what it leaves unexplained (RMS); a sliver where it is no spot.

    Two steps, the first from where the last held one started, which was as good as settled.
    """
    for again in (True, False):
        free = here.theta + here.step(SHAPE_SIGMA)[0]
        if not hypot(free[3], free[4]) < 0.95 * (1 + free[2]):
            return np.diag([1.0, 1e4]), here.variance**0.5
        if again:
            here = Normal.at(free, u, values, terms, here.beam)
    form = np.array([[1 + free[2] + free[3], free[4]], [free[4], 1 + free[2] - free[3]]])
    return form, here.variance**0.5


def _spread(u: Array, found: _Solution) -> float:
    """Mean square distance from the centre of what fixed it: slopes of the spot's own light."""
    off = u - found.centre[:, None]
    off *= off
    r2 = off[0] + off[1]
    pull = r2 * found.terms[HEIGHT] ** 2
    return float(pull @ r2) / float(pull.sum()) / 2


def _growth(window: _Window, mix: Array, found: _Solution) -> float:
    """How much larger than white noise would make it the centre's variance is, by the bare surface around the spot."""
    influence = (found.cov @ found.terms)[:2] / found.noise2
    rows, columns = window.near
    height, width = rows.stop - rows.start, columns.stop - columns.start
    around = window.surface.shape
    i = np.arange(rows.start % (height // 2), around[0] - height + 1, height // 2)
    j = np.arange(columns.start % (width // 2), around[1] - width + 1, width // 2)
    apart = (abs(i - rows.start)[:, None] >= height - 1) | (abs(j - columns.start) >= width - 1)  # not the spot itself
    place = (i[:, None] * around[1] + j)[apart]
    if len(place) == 0:
        return CRAMPED
    at = place[:, None] + (window.clear // width * around[1] + window.clear % width)
    moved = (window.values.reshape(-1, len(mix)) @ mix).take(at) @ influence.T
    # Texture, less noise: it shades the spot's own light too.
    paint = np.asarray(cv2.GaussianBlur(window.surface, (7, 7), 1.5), np.float64)
    paint = paint / max(cv2.mean(paint)[0], 1.0) - 1
    moved += paint.take(at) @ (found.height * influence * found.terms[5]).T
    ratios = ((moved @ _inverse(found.cov[:2, :2])) * moved).sum(axis=1)
    ratios.sort()
    median = float(ratios[(len(ratios) - 1) // 2] + ratios[len(ratios) // 2]) / 2
    limit = 6 * median + 1e-9  # an edge somewhere around is not under the spot
    return max(1.0, float(np.minimum(ratios, limit).sum()) / len(ratios) / 2)
