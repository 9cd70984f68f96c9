"""The laser's spot before the beam is known: a few compact green blobs of each image, and which of them lie on a beam.

One image cannot tell a spot from a glint. Over a dive the true ones agree three times over: left with right (they
meet), frame with frame (one straight line), and length with reading (one scale and offset).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from leadline.calibration.matches import find_matches
from leadline.errors import InputError
from leadline.recognition.spot import Spot
from leadline.recognition.spot_fit import SATURATED, SpotFit, fit_spot
from leadline.rig import Rig
from leadline.samples import NS_PER_S, Array, Image, LaserRange, Sample, StereoFrame

STATIC_S = 2.0
"""A frame's reading is the mean of those within this time of it: in a calibration dive nothing moves."""

_BLOBS = 6  # of each image
_RADII_PX = (2.0, 2.8)  # at each level of the pyramid
_LEVELS = 4
_CORE_PX = 25
_SIGMA = 0.6  # of a blob's radius: the light's
_SIZES, _ROUND = (0.2, 5.0), 0.3  # of a spot, against its blob
_CENTRE_PX = 0.1  # what a board's squares around a spot may do to its centre
_ON_BEAM_M, _ON_BEAM = 0.002, 0.004  # off the line, and of the depth: what a poor calibration leaves
_RANGE_OFF_M = 0.03
_STANDS_OUT = 1.2  # over the next best of its image: corners of a board that moves straight also lie on lines
_MIN_APART_M = 0.1  # between the two stations that a beam is drawn through
_MAX_PAIRS = 400


@dataclass(frozen=True, slots=True, eq=False)
class Station:
    """One stereo frame of a static dive: the spot in both images, the mean of its readings and their count."""

    name: str
    left: Spot
    right: Spot
    raw_m: float
    readings: int
    scatter_m: float  # standard deviation of one reading about the mean; NaN for one alone
    matches_px: Array = field(default_factory=lambda: np.zeros((0, 4)))  # left and right pixels of any other texture


@dataclass(frozen=True, slots=True, eq=False)
class Sighting:
    """A frame before the beam is known: what may be the spot, and the readings of the time around it."""

    name: str
    left: tuple[Spot, ...]
    right: tuple[Spot, ...]
    raw_m: float
    readings: int
    scatter_m: float
    matches_px: Array = field(default_factory=lambda: np.zeros((0, 4)))


def sightings(samples: Iterable[Sample], *, matched: bool = False) -> list[Sighting]:
    """Candidates and mean readings of all frames that have a reading within STATIC_S. Images are not kept.

    matched: also look for points that both images show, near the shift of the likeliest spot.
    """
    frames: list[tuple[int, str, tuple[Spot, ...], tuple[Spot, ...], Array]] = []
    readings: list[LaserRange] = []
    for sample in samples:
        if isinstance(sample, StereoFrame):
            left, right = spot_candidates(sample.left), spot_candidates(sample.right)
            matches = np.zeros((0, 4))
            if matched and left and right:
                matches = find_matches(sample.left, sample.right, right[0].q_px - left[0].q_px)
            frames.append((sample.t_ns, sample.name, left, right, matches))
        elif isinstance(sample, LaserRange):
            readings.append(sample)
    if not frames:
        raise InputError("no stereo frame can be read", "", "give a dive with frames.csv and its images")
    if not readings:
        raise InputError("no laser reading", "", "give a dive with laser.csv (t_s,range_m)")
    times, ranges = np.array([r.t_ns for r in readings]), np.array([r.range_m for r in readings])
    out = []
    for t_ns, name, left, right, matches in frames:
        near = ranges[np.abs(times - t_ns) <= STATIC_S * NS_PER_S]
        if len(near):
            out.append(Sighting(name, left, right, *_mean(near), matches))
    if not out:
        raise InputError(
            f"no reading within {STATIC_S:g} s of any frame", "", "frames.csv and laser.csv must share one clock"
        )
    return out


def _mean(ranges_m: Array) -> tuple[float, int, float]:
    """Mean, count and scatter of the readings that agree: a flyer (no return, a fish) must not pull the mean."""
    middle = float(np.median(ranges_m))
    spread = 1.4826 * float(np.median(np.abs(ranges_m - middle)))
    kept = ranges_m[np.abs(ranges_m - middle) <= 5 * spread + 0.005]
    return float(kept.mean()), len(kept), float(kept.std(ddof=1)) if len(kept) > 1 else float("nan")


def spot_candidates(image: Image) -> tuple[Spot, ...]:
    """Compact places of an image that are greener than their surroundings; (H, W, 3) BGR, or grey: brighter."""
    found: list[Spot] = []
    for at_px, radius_px, snr in _blobs(image.astype(np.float32) if image.ndim == 2 else _glow(image)):
        fit = _centred(image, at_px, radius_px)
        if fit is not None and all(np.linalg.norm(fit.q_px - s.q_px) > 2 for s in found):
            found.append(Spot(fit.q_px, fit.cov_px2 + _CENTRE_PX**2 * np.eye(2), snr))
    return tuple(found)


def _centred(image: Image, at_px: Array, radius_px: float) -> SpotFit | None:
    """First with the blob's size, then with its own; None where what is there is no spot."""
    first = fit_spot(image, at_px, (_SIGMA * radius_px) ** 2 * np.eye(2), alike=False)
    if first is None or np.linalg.norm(first.q_px - at_px) > 2 * radius_px + 3:
        return None
    if not (_SIZES[0] < first.size < _SIZES[1] and first.roundness > _ROUND):
        return first
    return fit_spot(image, first.q_px, first.shape_px2, alike=False) or first


def _glow(image: Image) -> Array:
    """Green above the mean of red and blue: zero on anything white or black.

    The core of a strong spot is so bright that it is white: what is saturated takes the glow of what is around it.
    """
    blue, green, red = (image[..., i].astype(np.float32) for i in range(3))
    excess = green - 0.5 * (blue + red)
    around = cv2.dilate(cv2.blur(excess, (3, 3)), np.ones((_CORE_PX, _CORE_PX), np.uint8))
    return np.asarray(np.where(green >= SATURATED, around, excess))


def _blobs(measure: Array) -> list[tuple[Array, float, float]]:
    """The strongest local maxima over place and size: pixel (2,), radius, height over the image's own noise."""
    found: list[tuple[float, Array, float]] = []
    level_image = np.asarray(measure, np.float32)
    for level in range(_LEVELS):
        for radius in _RADII_PX:
            side = 2 * round(4 * radius) + 1
            rise = cv2.GaussianBlur(level_image, (0, 0), 0.6 * radius) - cv2.blur(level_image, (side, side))
            found += _maxima(np.asarray(rise), 2.0**level, radius)
        level_image = np.asarray(
            cv2.resize(level_image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.float32
        )
        if min(level_image.shape) < 40:
            break
    found.sort(key=lambda blob: -blob[0])
    kept: list[tuple[Array, float, float]] = []
    for snr, at_px, radius_px in found:
        if all(np.linalg.norm(at_px - other) > 2 * max(radius_px, r) for other, r, _ in kept):
            kept.append((at_px, radius_px, snr))
        if len(kept) == _BLOBS:
            break
    return kept


def _maxima(rise: Array, scale: float, radius: float) -> list[tuple[float, Array, float]]:
    noise = 1.4826 * float(np.median(np.abs(rise[::3, ::3]))) + 0.1  # a ninth of the pixels tells it as well
    size = 2 * int(np.ceil(2 * radius)) + 1
    peak = (rise >= cv2.dilate(rise, np.ones((size, size), np.uint8))) & (rise > 5 * noise) & (rise > 2.0)
    v, u = np.nonzero(peak)
    order = np.argsort(-rise[v, u])[: 4 * _BLOBS]
    centres = (np.stack([u[order], v[order]], axis=1) + 0.5) * scale - 0.5
    return [(float(height), at, radius * scale) for height, at in zip(rise[v[order], u[order]], centres, strict=True)]


@dataclass(frozen=True, slots=True, eq=False)
class _Points:
    """Where left and right candidates meet: points (N, 3), left frame, and whose they are (N,)."""

    p_left_m: Array
    raw_m: Array
    owner: NDArray[np.intp]
    left: list[Spot]
    right: list[Spot]


def spot_stations(
    found: Sequence[Sighting], rig: Rig, gain: float, *, gain_off: float, meet_px: float
) -> list[Station]:
    """The candidates that lie on one beam whose readings grow by ``gain`` (+- the share ``gain_off``) for each metre.

    meet_px: how far (RMS) left and right may miss each other. [] where no beam goes through three frames.
    """
    points = _meetings(found, rig, meet_px)
    chosen = _best_beam(points, gain, gain_off)
    if not chosen or np.median([_stands_out(found, points, i) for i in chosen]) < _STANDS_OUT:
        return []
    return [
        Station(f.name, points.left[i], points.right[i], f.raw_m, f.readings, f.scatter_m, f.matches_px)
        for i in chosen
        for f in [found[int(points.owner[i])]]
    ]


def _stands_out(found: Sequence[Sighting], points: _Points, i: int) -> float:
    """How much higher a point's spots stand than all else in their images (the poorer of both)."""
    frame = found[int(points.owner[i])]
    others = [
        max((s.snr for s in side if s is not own), default=0.1)
        for side, own in ((frame.left, points.left[i]), (frame.right, points.right[i]))
    ]
    return min(points.left[i].snr / others[0], points.right[i].snr / others[1])


def _meetings(found: Sequence[Sighting], rig: Rig, meet_px: float) -> _Points:
    pairs = [(k, a, b) for k, f in enumerate(found) for a in f.left for b in f.right]
    if not pairs:
        return _Points(np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.intp), [], [])
    left_px, right_px = np.array([a.q_px for _, a, _ in pairs]), np.array([b.q_px for _, _, b in pairs])
    p_left_m, _ = rig.triangulate(left_px, right_px)
    seen_left, seen_right = rig.project(np.nan_to_num(p_left_m, nan=-1.0))
    miss = np.sqrt((np.sum((seen_left - left_px) ** 2, axis=1) + np.sum((seen_right - right_px) ** 2, axis=1)) / 4)
    keep = np.flatnonzero(miss <= meet_px)  # NaN is not kept
    owner = np.array([pairs[i][0] for i in keep], np.intp)
    raw_m = np.array([found[k].raw_m for k in owner])
    return _Points(p_left_m[keep], raw_m, owner, [pairs[i][1] for i in keep], [pairs[i][2] for i in keep])


def _best_beam(points: _Points, gain: float, gain_off: float) -> list[int]:
    """One point of each frame that agrees with the line and the scale that most frames agree with."""
    best: tuple[float, list[int]] = (0.0, [])
    for i, j in _pairs(points):
        apart = points.p_left_m[j] - points.p_left_m[i]
        length = float(np.linalg.norm(apart))
        slope = (points.raw_m[j] - points.raw_m[i]) / length if length > 0 else np.inf
        if length < _MIN_APART_M or abs(abs(slope) / gain - 1) > gain_off + 2 * _RANGE_OFF_M / length:
            continue
        direction = apart / length
        relative = points.p_left_m - points.p_left_m[i]
        along = relative @ direction
        off_m = np.linalg.norm(relative - along[:, None] * direction, axis=1)
        late_m = np.abs(points.raw_m - points.raw_m[i] - slope * along)
        misfit = off_m / (_ON_BEAM_M + _ON_BEAM * points.p_left_m[:, 2]) + late_m / _RANGE_OFF_M
        chosen = _one_each(points.owner, misfit)
        score = float(np.sum(2.0 - misfit[chosen]))
        if score > best[0]:
            best = (score, chosen)
    return best[1] if len(best[1]) >= 3 else []


def _pairs(points: _Points) -> list[tuple[int, int]]:
    """Pairs of points of different frames, a spread of them where they are many."""
    i, j = np.triu_indices(len(points.owner), 1)
    apart = points.owner[i] != points.owner[j]
    i, j = i[apart], j[apart]
    step = max(1, len(i) // (_MAX_PAIRS * 10))
    return list(zip(i[::step].tolist(), j[::step].tolist(), strict=True))


def _one_each(owner: NDArray[np.intp], misfit: Array) -> list[int]:
    """The best point of each frame, where it is good enough."""
    best: dict[int, int] = {}
    for i in np.flatnonzero(misfit < 2.0).tolist():
        frame = int(owner[i])
        if frame not in best or misfit[i] < misfit[best[frame]]:
            best[frame] = i
    return [best[frame] for frame in sorted(best)]
