"""Stereo on the whole target: many patches matched where the shape says they should be, and the shape fitted to them.

With a prediction once: each patch's place and slant follow from the shape, a few pixels are searched, the rest is
refined to a hundredth and triangulated, and the shape fitted. Without one, a coarse sweep first, and then twice.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import RBFInterpolator

from leadline.config import StereoConfig
from leadline.ranging.coarse import Box, coarse_points
from leadline.ranging.focus import lopsided, narrowed, textured
from leadline.ranging.images import Region
from leadline.ranging.layout import (
    LengthAt,
    Prediction,
    centres,
    levels,
    patch_size,
    predicted,
    round_inset,
    shared,
    visible,
)
from leadline.ranging.patches import Limits, Verdict, refine, search
from leadline.ranging.shape_fit import Fit, Points, fit
from leadline.ranging.surface_fit import fit_surface
from leadline.rig import Rig
from leadline.samples import Array, Image, Kind, Measurement, Rejected
from leadline.target import Cylinder, Plane, Sphere, Surface, Target

MAX_MISFIT = 30.0  # patches this far off their sigmas hold another shape: a pile and the sand behind it
NEAREST_M = 0.02
BOX_SIGMA = 0.2  # how well a box tells a ball's size
FIRST_REACH_PX, NEXT_REACH_PX, MOST_REACH_PX = 3.0, 1.5, 12.0
AS_PREDICTED_PX = 1.0  # patches that moved less than this need no second look
LARGER, ENOUGH = 1.6, 0.5
WHY = {
    Verdict.LEFT_THE_IMAGE: "out of the other camera's view",
    Verdict.OVER_EXPOSED: "over-exposed",
    Verdict.SMOOTH: "too little texture",
    Verdict.REPEATED: "repeated texture",
    Verdict.DIFFERENT: "nothing in common",
    Verdict.COVERED: "covered",
    Verdict.RAN_AWAY: "nothing in common",
}


NOTHING = Points(np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.empty(0))


@dataclass(frozen=True, slots=True)
class Pair:
    """Both images of a frame, and the rig that took them (with this frame's own skew)."""

    left_image: Image
    right_image: Image
    rig: Rig


@dataclass(frozen=True, slots=True)
class Prior:
    """A predicted target vector and the sigma of its range, which bounds the search."""

    x: Array
    range_sigma_m: float


@dataclass(frozen=True, slots=True)
class _Round:
    """What one matching gave: points on the target, how far they were from where they were expected, and the rest."""

    points: Points
    moved_px: float
    verdict: Array


class StereoRanger:
    def __init__(self, rig: Rig, target: Target, settings: StereoConfig) -> None:
        self._target, self._settings = target, settings
        self._limits = Limits(sigma_px=settings.max_sigma_px, correlation=settings.min_correlation)
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
        view, predicted_well = box, -1.0 if prior is None or isinstance(self._target, Surface) else AS_PREDICTED_PX
        target, points, found = self._begin(pair, box, prior)
        if found is None:
            return "no shape through the patches" if len(points.length_m) else "no texture in common"
        if isinstance(target, Cylinder):
            box = narrowed(pair.rig, target, found.x, view)
        coarse, fine = levels(self._settings, pair.rig.focal_outside_px, box, target.range(found.x)[0])
        if prior is None or predicted_well < 0:
            steps, reach_px = (coarse, fine), FIRST_REACH_PX
        else:
            steps, reach_px = (fine, fine), self._reach(pair.rig, prior, fine)
        left: Region | None = None
        for level in steps:
            if found is None:
                return "no shape through the patches"
            if left is None or left.level != level:
                left = self._left(pair, box, level)
            seen = self._match(pair, left, box, self._length_at(found, points), reach_px)
            points = seen.points
            if len(points.length_m) < self._settings.min_agreed:
                return _why(seen.verdict)
            found = self._shape(target, points, None if isinstance(target, Surface) else found.x)
            if seen.moved_px < predicted_well:
                break
            reach_px = NEXT_REACH_PX
        few = max(self._settings.min_agreed, 0.4 * len(points.length_m))
        if found is None or found.misfit > MAX_MISFIT or found.agreed.sum() < few:
            return "patches disagree"
        if isinstance(target, Cylinder) and lopsided(pair.rig, target, found.x, view, points.pick(found.agreed)):
            return "patches on one side only"
        return found

    def _begin(self, pair: Pair, box: Box, prior: Prior | None) -> tuple[Target, Points, Fit | None]:
        """The target, and a first idea of it: as predicted, else through coarse points (an unknown surface: always)."""
        if prior is not None and not isinstance(self._target, Surface):
            return self._target, NOTHING, Fit(prior.x, np.eye(len(prior.x)), np.empty(0, bool), 1.0)
        points = coarse_points(pair.rig, pair.left_image, pair.right_image, box)
        if points is None:
            return self._target, NOTHING, None
        target = self._expect(pair, box, points)
        if isinstance(target, Cylinder | Plane):  # which end somewhere in a view, and no box tells where
            points = textured(pair.rig, pair.left_image, box, points)
        return target, points, self._shape(target, points)

    def _shape(self, target: Target, points: Points, guess: Array | None = None) -> Fit | None:
        if isinstance(target, Surface):
            return fit_surface(points, self._beam)
        return fit(target, points, guess, self._settings.roughness_m)

    def _expect(self, pair: Pair, box: Box, points: Points) -> Target:
        """A ball of unknown size is expected to be as large as its box, if all of it is in the picture."""
        x, y, width, height = box
        rows, columns = pair.left_image.shape[:2]
        clipped = min(x, y) < 2 or x + width > columns - 2 or y + height > rows - 2
        if not isinstance(self._target, Sphere) or self._target.diameter_m is not None or clipped:
            return self._target
        sides = pair.rig.rays(np.array([[x, y + height / 2], [x + width, y + height / 2]]), "left")[1]
        sine = np.sin(np.arccos(np.clip(sides[0] @ sides[1], -1, 1)) / 2)
        radius = float(np.median(np.linalg.norm(points.p_m, axis=1)) * sine / (1 - 0.8 * sine))
        return Sphere(None, radius, BOX_SIGMA * radius)

    def _reach(self, rig: Rig, prior: Prior, level: int) -> float:
        """Pixels, at the level, that three sigma of the predicted range are worth."""
        near = max(self._target.range(prior.x)[0], NEAREST_M)
        moved = rig.focal_outside_px * rig.baseline_m * (1 / near - 1 / (near + 3 * prior.range_sigma_m)) / 2**level
        return float(min(max(moved, NEXT_REACH_PX), MOST_REACH_PX))

    def _left(self, pair: Pair, box: Box, level: int) -> Region:
        low, size = np.array(box[:2]), np.array(box[2:])
        margin = (LARGER * self._settings.half_px / 2 + 4) * 2**level  # patches stand over the box by half of theirs
        return Region.of(pair.left_image, level, low - margin, low + size + margin)

    def _length_at(self, found: Fit, points: Points) -> LengthAt:
        """Where rays meet the shape found so far; an unknown surface is a smooth sheet through its points."""
        if not isinstance(self._target, Surface):
            return lambda origins, directions: self._target.beam_length(found.x, origins, directions)[0]
        scale = np.ptp(points.directions, axis=0).max() + 1e-6
        sheet = RBFInterpolator(
            points.directions / scale, 1 / points.length_m, smoothing=0.3, kernel="thin_plate_spline"
        )
        return lambda _, directions: 1 / np.clip(sheet(directions / scale), 0.1, 10)

    def _match(self, pair: Pair, left: Region, box: Box, length_at: LengthAt, reach_px: float) -> _Round:
        """Matched points on the target. Where the texture is too poor for most patches, fewer and larger ones."""
        low, high = left.to_here(np.array(box[:2])), left.to_here(np.array(box[:2]) + box[2:])
        inset = round_inset(self._target)
        rounds = []
        for larger in (1.0, LARGER):
            half, count = patch_size(self._settings, high - low, left.level, larger)
            centre_px = centres(left, low + half / 2, high - half / 2, half, count, inset)
            rounds.append(self._match_patches(pair, left, centre_px, half, length_at, reach_px))
            if len(rounds[-1].points.length_m) > ENOUGH * len(centre_px):
                break
        return max(rounds, key=lambda seen: float((seen.points.sigma_m**-2).sum()))

    def _match_patches(
        self, pair: Pair, left: Region, centre_px: Array, half: int, length_at: LengthAt, reach_px: float
    ) -> _Round:
        """Those that cannot be seen, matched or trusted are left out."""
        level = left.level
        expected = predicted(pair.rig, left, centre_px, half, length_at)
        height, width = (n // 2**level for n in pair.right_image.shape[:2])
        keep = visible(expected.warp, width, height, 1.5 * half + 4)
        if not keep.any():  # none of none, too
            return _Round(NOTHING, 0.0, np.full(len(keep), Verdict.LEFT_THE_IMAGE))
        expected = expected.pick(keep)
        at_px = expected.warp.expected_px
        margin = 1.5 * half + reach_px + 6
        right = Region.of(
            pair.right_image, level, (at_px.min(axis=0) - margin) * 2**level, (at_px.max(axis=0) + margin) * 2**level
        )
        warp = replace(expected.warp, expected_px=at_px - right.corner_px)
        found = search(left.grey, right.grey, warp, reach_px)
        verdict = np.where(found.repeated, Verdict.REPEATED, Verdict.DIFFERENT)
        alike = ~found.repeated & (found.correlation > self._limits.correlation)
        matches = refine(left.grey, right.grey, warp.pick(alike), found.shift_px[alike], self._limits)
        verdict[alike] = matches.verdict
        good = matches.verdict == Verdict.MATCHED
        shift_px = matches.shift_px[good]
        matched = expected.pick(alike).pick(good)
        points = triangulated(pair.rig, matched, level, shift_px, matches.sigma_px[good])
        return _Round(points, float(np.sort(np.abs(shift_px))[len(shift_px) // 2]) if len(shift_px) else 0.0, verdict)


def _why(verdict: Array) -> str:
    """What most patches failed by."""
    failed = verdict[verdict != Verdict.MATCHED].astype(int)
    return WHY[Verdict(int(np.bincount(failed).argmax()))] if len(failed) else "too little texture"


def triangulated(rig: Rig, expected: Prediction, level: int, shift_px: Array, sigma_px: Array) -> Points:
    """Lengths along the left rays, of patches that are shifted from where they were expected; pixels of the level.

    The left pixel is exact by definition, all the error is in the right one.
    """
    if not len(shift_px):
        return NOTHING
    origins, directions, along = expected.origins_m, expected.directions, expected.warp.along
    inverse = 1 / expected.length_m + shift_px / expected.rate_px_m
    at_px = rig.project_one(origins + directions / inverse[:, None], "right")
    target_px = (expected.warp.expected_px + shift_px[:, None] * along + 0.5) * 2**level - 0.5
    inverse += np.einsum("ni,ni->n", along, target_px - at_px) / 2**level / expected.rate_px_m  # not quite even
    good = np.isfinite(inverse) & (inverse > 0) & (inverse < 1 / NEAREST_M)
    common = shared(expected.warp.centre_px, 2 * expected.warp.half + 1)
    points = Points(origins, directions, 1 / inverse, sigma_px / expected.rate_px_m / inverse**2, common)
    return points if good.all() else points.pick(good)
