"""Stereo on the whole target: many patches matched where the shape says they should be, and the shape fitted to them.

Coarse (only without a prediction), then twice: predict each patch's place and slant from the shape, search a few
pixels, refine to a hundredth, triangulate, fit. The second round starts so close that nothing is linearised in it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RBFInterpolator

from leadline.config import StereoConfig
from leadline.ranging.coarse import Box, coarse_points
from leadline.ranging.images import Float32, grey, shrink, to_full, to_level
from leadline.ranging.patches import Warp, bend_terms, refine, search
from leadline.ranging.shape_fit import Fit, Points, fit
from leadline.ranging.surface_fit import fit_surface
from leadline.rig import Rig
from leadline.samples import Array, Image, Kind, Measurement, Rejected
from leadline.target import Sphere, Surface, Target

SURFACE_INNER = 0.9
MAX_MISFIT = 30.0  # patches this far off their sigmas hold another shape: a pile and the sand behind it
BOX_SIGMA = 0.2  # how well a box tells a ball's size
LengthAt = Callable[[Array], Array]  # left pixels (N, 2), full size -> predicted length along their rays (N,)


@dataclass(frozen=True, slots=True)
class Pair:
    """Both images of a frame, as they came and grey, and the rig that took them (with this frame's own skew)."""

    left_image: Image
    right_image: Image
    left: Float32
    right: Float32
    rig: Rig

    @classmethod
    def of(cls, left: Image, right: Image, rig: Rig) -> Pair:
        return cls(left, right, grey(left), grey(right), rig)


@dataclass(frozen=True, slots=True)
class Prior:
    """A predicted target vector and the sigma of its range, which bounds the search."""

    x: Array
    range_sigma_m: float


class StereoRanger:
    def __init__(self, rig: Rig, target: Target, settings: StereoConfig) -> None:
        self._rig, self._target, self._settings = rig, target, settings
        beam = rig.laser
        self._beam = None if beam is None else (np.asarray(beam.origin_m), np.asarray(beam.direction))

    def measure(self, t_ns: int, pair: Pair, box: Box, prior: Prior | None) -> Measurement | Rejected:
        """The target's vector from one pair of images, or why there is none."""
        found = self.fit(pair, box, prior)
        if isinstance(found, str):
            return Rejected(Kind.STEREO, t_ns, found)
        eye = np.eye(len(found.x))
        return Measurement(Kind.STEREO, t_ns, found.x, found.cov, lambda x: (x, eye))

    def fit(self, pair: Pair, box: Box, prior: Prior | None) -> Fit | str:
        level = max(0, int(np.round(np.log2(max(box[2], box[3]) / self._settings.target_px))))
        left, right = shrink(pair.left, level), shrink(pair.right, level)
        half = self._half(box, level)
        centres = self._centres(box, level, half, left.shape)
        if prior is None or isinstance(self._target, Surface):
            points = coarse_points(self._rig, pair.left, pair.right, box)
            if points is None:
                return "no texture in common"
            target = self._expect(box, points, pair.left.shape)
            found, reach_px = self._shape(target, points), 3.0
        else:
            target, points, found = self._target, None, Fit(prior.x, np.eye(len(prior.x)), np.empty(0, bool), 1.0)
            reach_px = self._reach(prior, level)
        for _ in range(2):
            if found is None:
                return "no shape through the patches"
            length_at = self._length_at(found, points)
            points = self._match(left, right, centres, half, length_at, level, reach_px)
            if len(points.length_m) < self._settings.min_agreed:
                return "too little texture"
            found, reach_px = self._shape(target, points, None if isinstance(target, Surface) else found.x), 1.5
        if found is None or found.misfit > MAX_MISFIT:
            return "patches disagree"
        if found.agreed.sum() < max(self._settings.min_agreed, 0.4 * len(found.agreed)):
            return "patches disagree"
        return found

    def _shape(self, target: Target, points: Points, guess: Array | None = None) -> Fit | None:
        if isinstance(target, Surface):
            return fit_surface(points, self._beam)
        return fit(target, points, guess, self._settings.roughness_m)

    def _expect(self, box: Box, points: Points, shape: tuple[int, ...]) -> Target:
        """A ball of unknown size is expected to be as large as its box, if all of it is in the picture."""
        x, y, width, height = box
        clipped = min(x, y) < 2 or x + width > shape[1] - 2 or y + height > shape[0] - 2
        if not isinstance(self._target, Sphere) or self._target.diameter_m is not None or clipped:
            return self._target
        sides = self._rig.rays(np.array([[x, y + height / 2], [x + width, y + height / 2]]), "left")[1]
        sine = np.sin(np.arccos(np.clip(sides[0] @ sides[1], -1, 1)) / 2)
        radius = float(np.median(np.linalg.norm(points.p_m, axis=1)) * sine / (1 - 0.8 * sine))
        return Sphere(None, radius, BOX_SIGMA * radius)

    def _reach(self, prior: Prior, level: int) -> float:
        """Pixels, at the level, that three sigma of the predicted range are worth."""
        distance, _ = self._target.range(prior.x)
        ends = np.array([[0, 0, distance], [0, 0, distance + 3 * prior.range_sigma_m]])
        moved = np.ptp(self._rig.project(ends)[1][:, 0]) / 2**level
        return float(np.clip(moved, 1.5, 12.0))

    def _half(self, box: Box, level: int) -> int:
        """Half the side of a patch: smaller on a small target, so that there are still enough of them."""
        side = np.sqrt(box[2] * box[3]) / 2**level
        return int(np.clip(side / 8, self._settings.min_half_px, self._settings.half_px))

    def _centres(self, box: Box, level: int, half: int, shape: tuple[int, int]) -> Array:
        """About ``patches`` whole-pixel centres (N, 2) at the level, that do not overlap more than by half."""
        x, y, width, height = box
        step = max(np.sqrt(width * height / self._settings.patches) / 2**level, half)
        low = to_level(np.array([x, y]), level) + half / 2
        high = to_level(np.array([x + width, y + height]), level) - half / 2
        axes = [np.arange(a + (b - a) % step / 2, b, step) for a, b in zip(low, high, strict=True)]
        q_px = np.round(np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2))
        margin = half + 2
        clear = (q_px >= margin).all(axis=1) & (q_px[:, 0] < shape[1] - margin) & (q_px[:, 1] < shape[0] - margin)
        if isinstance(self._target, Surface):  # the corners of a box are most likely not the target
            off = (to_full(q_px, level) - [x + width / 2, y + height / 2]) / [width / 2, height / 2]
            clear &= (off**2).sum(axis=1) < SURFACE_INNER**2
        return np.asarray(q_px[clear])

    def _length_at(self, found: Fit, points: Points | None) -> LengthAt:
        """Where rays meet the shape found so far; an unknown surface is a smooth sheet through its points."""
        if points is None or not isinstance(self._target, Surface):
            return lambda q_px: self._target.beam_length(found.x, *self._rig.rays(q_px, camera="left"))[0]
        q_known_px = self._rig.project(points.p_m)[0]
        scale = np.ptp(q_known_px, axis=0).max() + 1.0
        sheet = RBFInterpolator(q_known_px / scale, 1 / points.length_m, smoothing=0.3, kernel="thin_plate_spline")
        return lambda q_px: 1 / np.clip(sheet(q_px / scale), 0.1, 10)

    def _match(
        self, left: Float32, right: Float32, centres: Array, half: int, length_at: LengthAt, level: int, reach_px: float
    ) -> Points:
        """Matched points on the target; patches that cannot be seen, matched or trusted are left out."""
        warp, keep = self._warp(centres, half, length_at, level, right.shape)
        if not keep.any():
            return Points(np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.empty(0))
        start, _ = search(left, right, warp, reach_px)
        matches = refine(left, right, warp, start)
        good = (matches.sigma_px < self._settings.max_sigma_px) & (matches.correlation > self._settings.min_correlation)
        good &= np.isfinite(matches.shift_px)
        left_px = to_full(warp.centre_px[good], level)
        right_px = to_full(warp.expected_px[good] + matches.shift_px[good, None] * warp.along[good], level)
        return self._triangulate(left_px, right_px, matches.sigma_px[good] * 2**level)

    def _triangulate(self, left_px: Array, right_px: Array, sigma_px: Array) -> Points:
        """Lengths along the left rays: the left pixel is exact by definition, all the error is in the right one."""
        if not len(left_px):
            return Points(np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.empty(0))
        origins, directions = self._rig.rays(left_px, camera="left")
        p_m = self._rig.triangulate(left_px, right_px)[0]
        lengths = np.einsum("ni,ni->n", p_m - origins, directions)
        _, jacobian = self._rig.project_with_jacobian(origins + lengths[:, None] * directions, camera="right")
        px_per_m = np.linalg.norm(np.einsum("nij,nj->ni", jacobian, directions), axis=1)
        good = np.isfinite(lengths) & (lengths > 0.02) & (px_per_m > 0)
        return Points(origins, directions, lengths, sigma_px / px_per_m).pick(good)

    def _warp(
        self, centres: Array, half: int, length_at: LengthAt, level: int, shape: tuple[int, int]
    ) -> tuple[Warp, Array]:
        """Place and bend of each patch, from nine rays through it and the predicted surface."""
        arms = half * np.stack(np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]), axis=-1).reshape(-1, 2)
        q_left_px = to_full((centres[:, None] + arms).reshape(-1, 2), level)
        origins, directions = self._rig.rays(q_left_px, camera="left")
        p_m = origins + length_at(q_left_px)[:, None] * directions
        at_px, jacobian = self._rig.project_with_jacobian(p_m, camera="right")
        seen = to_level(at_px, level).reshape(-1, 9, 2)
        along = np.einsum("nij,nj->ni", jacobian[4::9], directions[4::9])
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        terms = np.vstack([bend_terms(*arms.T), np.ones(9)])
        bend = np.einsum("nai,ak->nik", seen, np.linalg.pinv(terms))
        margin = half * 1.5 + 4
        keep = np.isfinite(seen).all(axis=(1, 2)) & (np.linalg.det(np.nan_to_num(bend[:, :, :2])) > 0.2)
        with np.errstate(invalid="ignore"):
            keep &= ((seen[:, 4] > margin) & (seen[:, 4] < [shape[1] - margin, shape[0] - margin])).all(axis=1)
        return Warp(centres[keep], half, seen[keep, 4], bend[keep, :, :5], along[keep]), keep
