"""The centre of a spot of light to a small part of a pixel, and how certain that is.

A Gaussian of free size and shape on a sloping ground is fitted to the pixels by least squares. What is saturated is
left out: the flanks tell the centre of a spot whose top is cut off. The colours are first mixed into one channel so
that the surface's own texture cancels as far as it has another colour than the spot (Fisher's discriminant).

How far texture and noise may have pulled the centre is measured, not assumed: the very same fit, linearised, is let
loose on the bare surface around the spot, and what it makes of that widens the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, hypot

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
HELD = 0.01  # of the form: first held to what is expected, relative (1 sigma), then let go
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
    inner: Array  # (m, C) its samples
    r2: Array  # (m,) their square distance from the start: the expected spot is the unit circle
    clear: NDArray[np.intp]  # (n,) which of them are not saturated
    u: Array  # (2, n) the places of those


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
    start_px, glare = _glare(image, start_px, np.sqrt(shape_px2.diagonal()))
    window = _cut(image, dark, start_px, shape_px2, root, glare)
    if window is None:
        return None
    clear = window.inner.take(window.clear, axis=0)
    mix = _mix(window, clear, float(root[0, 0] * root[1, 1]))
    found = _solve(window, clear @ mix)
    if found is None:
        return None
    growth = _growth(window, mix, found)
    spread = _spread(window.u, found)
    floor2 = FLOOR_PX**2 + (CUT_OFF * max(spread - 1.0, 0.0)) ** 2 * float(np.trace(shape_px2)) / 2
    to_px = root @ found.cov[:2, :2] @ root.T
    light = _inverse(found.form)
    narrow, wide = np.sqrt(_axes(light))
    return SpotFit(
        q_px=start_px + root @ found.centre,
        cov_px2=growth * to_px + floor2 * np.eye(2),
        shape_px2=root @ light @ root.T,
        height=_heights(clear, found.terms[5:]),
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
    apart = hypot((p - s) / 2, q)
    return (p + s) / 2 - apart, (p + s) / 2 + apart


def _solved(a: Array, b: Array) -> Array:
    """The solution (n,) or (n, k) of a x = b; OpenCV's takes a third of NumPy's time for matrices this small."""
    return np.asarray(cv2.solve(a, b.reshape(len(b), -1))[1], np.float64).reshape(b.shape)


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
    mix = _solved(off.T @ off / len(off) + grain**2 * np.eye(channels), spot)
    if mix[1] <= 0:
        return np.array([0.0, 1.0, 0.0])
    mix /= mix[1]
    mix[[0, 2]] = np.clip(mix[[0, 2]], -2, 2) * variance_px2 / (variance_px2 + SUBSAMPLED_PX2)
    return np.asarray(mix)


def _solve(window: _Window, values: Array) -> _Solution | None:
    """Least squares by Gauss-Newton: the centre with the expected form, then the form that the light really has.

    A form that is held costs the centre nothing, and a top that is cut off cannot bend it.
    """
    u, r2 = window.u, window.r2.take(window.clear)
    terms = np.empty((9, len(values)))
    terms[5], terms[6], terms[7:] = np.exp(-0.5 * r2), 1.0, u
    theta = np.zeros(9)
    theta[5:] = _heights(values, terms[5:])
    for _ in range(MAX_STEPS):
        here = _Normal.at(theta, u, values, terms)
        step, normal = here.step(HELD)
        theta = theta + step
        if max(abs(theta[:2])) > 3:
            return None
        if max(abs(step[:2])) < SETTLED:
            break
    else:
        return None
    bare = here.residual[r2 > window.ring**2]  # a top that is no Gaussian is not noise
    noise2 = float(bare @ bare) / len(bare) + 1e-3 if len(bare) >= _MIN_PIXELS else here.variance
    form, left = _form(here, u, values, terms.copy())
    return _Solution(
        centre=theta[:2],
        form=form,
        height=float(theta[5]),
        terms=terms,
        cov=np.asarray(noise2 * cv2.invert(normal)[1]),
        noise2=noise2,
        height_sigma=float(np.sqrt(noise2 / normal[5, 5])),
        residual=left,
    )


def _form(here: _Normal, u: Array, values: Array, terms: Array) -> tuple[Array, float]:
    """Inverse covariance (2, 2) of the light, and what it leaves unexplained (RMS); a sliver where it is no spot.

    Two steps, the first from where the last held one started, which was as good as settled.
    """
    for again in (True, False):
        free = here.theta + here.step(SHAPE_SIGMA)[0]
        if not hypot(free[3], free[4]) < 0.95 * (1 + free[2]):
            return np.diag([1.0, 1e4]), here.variance**0.5
        if again:
            here = _Normal.at(free, u, values, terms)
    form = np.array([[1 + free[2] + free[3], free[4]], [free[4], 1 + free[2] - free[3]]])
    return form, here.variance**0.5


@dataclass(frozen=True, slots=True)
class _Normal:
    """The normal equations at theta: centre (2), form (3), height and ground (3)."""

    theta: Array  # (9,)
    matrix: Array  # (9, 9)
    pull: Array  # (9,)
    residual: Array  # (n,)
    variance: float

    @classmethod
    def at(cls, theta: Array, u: Array, values: Array, terms: Array) -> _Normal:
        """The first six rows of ``terms`` are overwritten."""
        _evaluate(theta, u, terms)
        residual = values - theta[5:] @ terms[5:]
        variance = float(residual @ residual) / max(len(values) - 9, 5) + 1e-3
        matrix = terms @ terms.T
        matrix.ravel()[::10] += 1e-9
        return cls(theta, matrix, terms @ residual, residual, variance)

    def step(self, form_sigma: float) -> tuple[Array, Array]:
        """With the form held to what is expected by so much; and the matrix that holds it."""
        hold = self.variance / form_sigma**2
        matrix, pull = self.matrix.copy(), self.pull.copy()
        matrix.ravel()[20:41:10] += hold
        pull[2:5] -= hold * self.theta[2:5]
        return np.minimum(np.maximum(_solved(matrix, pull), -LONGEST), LONGEST), matrix


def _evaluate(theta: Array, u: Array, terms: Array) -> None:
    """The model's derivatives by its first six parameters, in place; terms[5] is the Gaussian itself."""
    cx, cy, size, stretch, skew, height = theta[:6].tolist()
    off = u - np.array([[cx], [cy]])
    by = np.array([[1 + size + stretch, skew], [skew, 1 + size - stretch]]) @ off
    both = off * by
    light = np.exp(-0.5 * (both[0] + both[1]))
    np.multiply(by, height * light, out=terms[:2])
    half = (-0.5 * height * light) * off
    x2, y2 = half * off
    np.add(x2, y2, out=terms[2])
    np.subtract(x2, y2, out=terms[3])
    np.multiply(half[0], 2 * off[1], out=terms[4])
    terms[5] = light


def _heights(values: Array, linear: Array) -> Array:
    """Height and ground (4,) of values (n,), or the heights (C,) of (n, C), for a known place and form."""
    fitted = _solved(linear @ linear.T, linear @ values)
    return fitted if values.ndim == 1 else np.asarray(fitted[0])


def _spread(u: Array, found: _Solution) -> float:
    pull = found.terms[0] ** 2 + found.terms[1] ** 2
    off = u - found.centre[:, None]
    off *= off
    return float(pull @ off[0] + pull @ off[1]) / float(pull.sum()) / 2


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
