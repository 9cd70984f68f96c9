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

from leadline.recognition.spot_model import CENTRE, FORM, GLOW, HEIGHT, Beamed, Normal, distance2, monomials, solved
from leadline.samples import Array, Image

SATURATED = 250  # grey level; codecs put ripples of some levels on what was 255
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
SHARP = np.array([0.1, 0.25])  # and blue and red count so much beside green: half of what they have in the brightness

GRAIN = 2.0  # grey levels of noise taken for granted in the mean over a spot of 2 px sigma
FLOOR_PX = 0.01  # what no pixel tells: spots that are no Gaussians, codecs
CUT_OFF = 0.002  # and where the top is cut off, this part of a sigma the more, the farther out the flanks
GRID_PX = 0.2  # and what falls between the pixels: times exp(-(pi sigma)^2), for spots with a sigma below 0.6 px
BEAM_END = 0.2  # how a beam ends on a surface is known to this part of a sigma, times how much it glows of the spot
EXPECTED = 0.3  # a form that differs by less is known well enough after one step
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

    values: NDArray[np.float32]  # (h, w, C) of the surroundings
    surface: NDArray[np.float32]  # (h, w) how they look themselves, in green light
    ring: float  # beyond so many sigmas is bare ground
    near: tuple[slice, slice]  # the fitted window in them
    inner: Array  # (m, C) its samples
    r2: Array  # (m,) their square distance from the start: the expected spot is the unit circle
    clear: NDArray[np.intp]  # (n,) which of them are not saturated
    basis: Array  # (6, n) the monomials of the places of those


@dataclass(frozen=True, slots=True)
class _Solution:
    centre: Array  # (2,) in units of the expected sigma
    form: Array  # (2, 2) inverse covariance of the light there
    height: float
    glow: float
    terms: Array  # (m, n) d(model)/d(parameter)
    gram: Array  # (m, m) of them
    cov: Array  # (m, m) as of white noise
    noise2: float  # its variance
    height_sigma: float  # for a known place and form
    residual: float  # RMS


def fit_spot(
    image: Image,
    start_px: Array,
    shape_px2: Array,
    beam_px_m: Array | None = None,
    dark: Image | None = None,
    *,
    alike: bool = True,
) -> SpotFit | None:
    """The spot near ``start_px`` (2,) of about the shape ``shape_px2`` (2, 2); None where the fit does not settle.

    image: (H, W, 3) BGR or (H, W) grey. beam_px_m: (2,) how far the beam's image runs in a metre of it, away from the
    laser; without, no glow is fitted. dark: the same view without the laser, aligned; then the difference counts.
    alike: the surroundings are as the surface under the spot; if not (a board's squares), the covariance is of noise.
    """
    root = _root(shape_px2)
    start_px, glare = _glare(image, start_px, shape_px2)
    window = _cut(image, dark, start_px, shape_px2, root, glare)
    if window is None:
        return None
    clear = window.inner if len(window.clear) == len(window.inner) else window.inner.take(window.clear, axis=0)
    mix = _mix(window, clear, float(root[0, 0] * root[1, 1]))
    beam = None if beam_px_m is None else Beamed.of(solved(root, beam_px_m))
    held = max(HELD, BLUR_PX2 / float(root[0, 0] * root[1, 1]))
    found = _solve(window, clear @ mix, beam, held)
    if found is None:
        return None
    growth = _growth(window, mix, found) if alike else 1.0
    light = _inverse(found.form)
    narrow, wide = (value**0.5 for value in _axes(light))
    spread = _spread(window.basis, found)
    to_px = root @ found.cov[:2, :2] @ root.T
    return SpotFit(
        q_px=start_px + root @ found.centre,
        cov_px2=growth * to_px + _unseen(shape_px2, narrow * wide, spread, found, beam_px_m),
        shape_px2=root @ light @ root.T,
        height=solved(found.gram[HEIGHT:, HEIGHT:], found.terms[HEIGHT:] @ clear)[0],
        snr=found.height / (found.height_sigma * growth**0.5),
        size=(narrow * wide) ** 0.5,
        roundness=narrow / wide,
        misfit=found.residual / abs(found.height),
        spread=spread,
    )


def _unseen(shape_px2: Array, size2: float, spread: float, found: _Solution, beam_px_m: Array | None) -> Array:
    """Covariance (2, 2) px^2 of what no pixel tells."""
    (p, q), (_, r) = shape_px2.tolist()
    grid = GRID_PX * exp(-(pi**2) * min(size2, 4.0) * (p + r) / 2)
    floor2 = FLOOR_PX**2 + grid**2 + (CUT_OFF * max(spread - 1.0, 0.0)) ** 2 * (p + r) / 2
    if beam_px_m is None:
        return np.array([[floor2, 0.0], [0.0, floor2]])
    x, y = beam_px_m.tolist()
    pull = BEAM_END * found.glow / max(found.height, 1.0)
    along = pull**2 * (x * x * p + 2 * x * y * q + y * y * r) / (x * x + y * y) ** 2
    return np.array([[floor2 + along * x * x, along * x * y], [along * x * y, floor2 + along * y * y]])


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
    basis = monomials(grid.reshape(2, -1))
    r2 = basis[3] + basis[5]
    inner = values[near].reshape(-1, values.shape[2]).astype(np.float64)
    if len(clear) < len(inner):
        basis = basis.take(clear, axis=1)
    return _Window(values, surface, RING + glare, near, inner, r2, clear, basis)


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


def _glare(image: Image, start_px: Array, shape_px2: Array) -> tuple[Array, float]:
    """The middle of what is saturated around a start, and by how many sigmas such a spot shows farther out."""
    x, y = start_px.tolist()
    column, row = min(max(round(x), 0), image.shape[1] - 1), min(max(round(y), 0), image.shape[0] - 1)
    if image[row, column].max() < SATURATED:
        return start_px, 0.0
    along, down = float(shape_px2[0, 0]) ** 0.5, float(shape_px2[1, 1]) ** 0.5
    top, left = max(row - ceil(4 * down), 0), max(column - ceil(4 * along), 0)
    part = image[top : row + ceil(4 * down) + 1, left : column + ceil(4 * along) + 1]
    rows, columns = np.nonzero(_brightest(part) >= SATURATED)
    middle = np.array([left + columns.mean(), top + rows.mean()])
    return middle, GLARE * min((len(rows) / pi / (along * down)) ** 0.5, 3.0)


def _brightest(image: Image) -> Image:
    """(H, W) the largest of a pixel's channels."""
    return image if image.ndim == 2 else np.maximum(np.maximum(image[..., 0], image[..., 1]), image[..., 2])


def _averaged(values: NDArray[np.uint8 | np.float32], block: int, size: tuple[int, int]) -> NDArray[np.float32]:
    single = np.asarray(values, np.float32)
    return single if block == 1 else np.asarray(cv2.resize(single, size, interpolation=cv2.INTER_AREA), np.float32)


def _mix(window: _Window, clear: Array, variance_px2: float) -> Array:
    """Weights (C,) of the channels in which the spot stands out best from the ground around it; green's is 1."""
    channels = window.values.shape[2]
    if channels == 1:
        return np.ones(1)
    ground = window.inner[window.r2 > window.ring**2]
    middle = np.ones(len(ground)) @ ground / len(ground)
    weight = np.exp(-0.5 * (window.basis[3] + window.basis[5]))
    spot = weight @ clear / weight.sum() - middle
    grain = GRAIN * 2 / max(variance_px2**0.5, 2.0)
    spread = ground.T @ ground / len(ground) - middle[:, None] * middle
    mix = solved(spread + grain**2 * np.eye(channels), spot)
    if mix[1] <= 0:
        return np.array([0.0, 1.0, 0.0])
    mix /= mix[1]
    share = variance_px2 / (variance_px2 + SUBSAMPLED_PX2)
    mix[[0, 2]] = share * np.minimum(np.maximum(mix[[0, 2]], -2), 2) + (1 - share) * SHARP
    return np.asarray(mix)


def _solve(window: _Window, values: Array, beam: Beamed | None, held: float) -> _Solution | None:
    """Least squares by Gauss-Newton: the centre with about the expected form, then the form that the light really has.

    A form that is held costs the centre nothing, and a top that is cut off cannot bend it.
    """
    basis, count = window.basis, 9 if beam is None else 10
    rows = np.empty((count + 1, len(values)))
    rows[count] = values
    here = Normal.start(basis, rows, beam)
    theta, last = here.theta, np.zeros(2)
    for _ in range(MAX_STEPS):
        step, normal = here.step(held)
        settled = max(abs(step[CENTRE]).tolist()) < SETTLED
        if not settled and float(step[CENTRE] @ last) < 0:
            step *= 0.5  # to and fro between two pixels
        theta, last = theta + step, step[CENTRE]
        if max(abs(theta[CENTRE]).tolist()) > 3:
            return None
        if settled:
            break
        here = Normal.at(theta, basis, rows, beam)
    else:
        return None
    outside = basis[3] + basis[5] > window.ring**2  # a top that is no Gaussian is not noise
    bare = here.residual(rows)[outside]
    noise2 = float(bare @ bare) / len(bare) + 1e-3 if len(bare) >= _MIN_PIXELS else here.variance
    form, left = _form(here, basis, rows)
    return _Solution(
        centre=theta[CENTRE],
        form=form,
        height=float(theta[HEIGHT]),
        glow=0.0 if beam is None else max(float(theta[GLOW]), 0.0),
        terms=rows[:-1],
        gram=here.matrix,
        cov=np.asarray(noise2 * cv2.invert(normal)[1]),
        noise2=noise2,
        height_sigma=(noise2 / float(normal[HEIGHT, HEIGHT])) ** 0.5,
        residual=left,
    )


def _form(here: Normal, basis: Array, rows: Array) -> tuple[Array, float]:
    """Inverse covariance (2, 2) of the light, and what it leaves unexplained (RMS); a sliver where it is no spot.

    Two steps, the first from where the last held one started, which was as good as settled; or that one alone where
    the form is about what was expected.
    """
    step = here.step(SHAPE_SIGMA)[0]
    near = max(abs(step[FORM]).tolist()) < EXPECTED
    for last in (near, True):
        size, stretch, skew = (here.theta + step)[FORM].tolist()
        if not hypot(stretch, skew) < 0.95 * (1 + size):
            return np.diag([1.0, 1e4]), here.rms()
        if last:
            break
        here = Normal.at(here.theta + step, basis, rows.copy(), here.beam)
        step = here.step(SHAPE_SIGMA)[0]
    return np.array([[1 + size + stretch, skew], [skew, 1 + size - stretch]]), here.rms(step if near else None)


def _spread(basis: Array, found: _Solution) -> float:
    """Mean square distance from the centre of what fixed it: slopes of the spot's own light."""
    x, y = found.centre.tolist()
    r2 = distance2(basis, x, y)
    pull = r2 * found.terms[HEIGHT] ** 2
    return float(pull @ r2) / float(pull.sum()) / 2


def _growth(window: _Window, mix: Array, found: _Solution) -> float:
    """How much larger than white noise would make it the centre's variance is, by the bare surface around the spot."""
    influence = found.cov[:2] @ found.terms / found.noise2
    rows, columns = window.near
    height, width = rows.stop - rows.start, columns.stop - columns.start
    tall, wide = window.surface.shape
    place = [
        i * wide + j
        for i in range(rows.start % (height // 2), tall - height + 1, height // 2)
        for j in range(columns.start % (width // 2), wide - width + 1, width // 2)
        if abs(i - rows.start) >= height - 1 or abs(j - columns.start) >= width - 1  # not the spot itself
    ]
    if not place:
        return CRAMPED
    at = np.array(place)[:, None] + (window.clear + window.clear // width * (wide - width))
    mixed = window.values.reshape(-1, len(mix)) @ mix.astype(np.float32)
    # Texture, less noise: it shades the spot's own light too.
    paint = cv2.GaussianBlur(window.surface, (7, 7), 1.5)
    shaded = influence * (found.height / max(cv2.mean(paint)[0], 1.0) * found.terms[HEIGHT])
    moved = mixed.take(at) @ influence.T + paint.take(at) @ shaded.T - shaded.sum(axis=1)
    ratios: list[float] = sorted(((moved @ _inverse(found.cov[:2, :2])) * moved).sum(axis=1).tolist())
    median = (ratios[(len(ratios) - 1) // 2] + ratios[len(ratios) // 2]) / 2
    limit = 6 * median + 1e-9  # an edge somewhere around is not under the spot
    return max(1.0, sum(min(ratio, limit) for ratio in ratios) / len(ratios) / 2)
