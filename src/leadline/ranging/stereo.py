"""Stereo on the whole target: many patches matched where the shape says they should be, and the shape fitted to them.

With a prediction once: each patch's place and slant follow from the shape, a few pixels are searched, the rest is
refined to a hundredth and triangulated, and the shape fitted. Without one, a coarse sweep first, and then twice.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RBFInterpolator

from leadline.config import StereoConfig
from leadline.ranging.coarse import Box, coarse_points
from leadline.ranging.images import Region
from leadline.ranging.layout import LengthAt, centres, predicted, visible
from leadline.ranging.patches import Limits, Verdict, Warp, refine, search
from leadline.ranging.shape_fit import Fit, Points, fit
from leadline.ranging.surface_fit import fit_surface
from leadline.rig import Rig
from leadline.samples import Array, Image, Kind, Measurement, Rejected
from leadline.target import Sphere, Surface, Target

ROUND_INSET = 0.9
MAX_MISFIT = 30.0  # patches this far off their sigmas hold another shape: a pile and the sand behind it
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

    @classmethod
    def of(cls, left: Image, right: Image, rig: Rig) -> Pair:
        return cls(left, right, rig)


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
        level = max(0, int(np.round(np.log2(max(box[2], box[3], 1.0) / self._settings.target_px))))
        if prior is None or isinstance(self._target, Surface):
            points = coarse_points(pair.rig, pair.left_image, pair.right_image, box)
            if points is None:
                return "no texture in common"
            target, reach_px, predicted_well = self._expect(pair, box, points), FIRST_REACH_PX, -1.0
            found = self._shape(target, points)
        else:
            target, reach_px, predicted_well = self._target, self._reach(pair.rig, prior, level), AS_PREDICTED_PX
            points, found = NOTHING, Fit(prior.x, np.eye(len(prior.x)), np.empty(0, bool), 1.0)
        left = self._left(pair, box, level)
        for _ in range(2):
            if found is None:
                return "no shape through the patches"
            seen = self._match(pair, left, box, self._length_at(found, points), reach_px)
            points = seen.points
            if len(points.length_m) < self._settings.min_agreed:
                return _why(seen.verdict)
            found = self._shape(target, points, None if isinstance(target, Surface) else found.x)
            if seen.moved_px < predicted_well:
                break
            reach_px = NEXT_REACH_PX
        if found is None or found.misfit > MAX_MISFIT:
            return "patches disagree"
        if found.agreed.sum() < max(self._settings.min_agreed, 0.4 * len(found.agreed)):
            return "patches disagree"
        return found

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
        distance, _ = self._target.range(prior.x)
        ends = np.array([[0, 0, distance], [0, 0, distance + 3 * prior.range_sigma_m]])
        moved = np.ptp(rig.project_one(ends, "right")[:, 0]) / 2**level
        return float(np.clip(moved, NEXT_REACH_PX, MOST_REACH_PX))

    def _left(self, pair: Pair, box: Box, level: int) -> Region:
        low, size = np.array(box[:2]), np.array(box[2:])
        margin = (LARGER * self._settings.half_px + 4) * 2**level
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
        """Matched points on the target. Where the texture is too poor for most patches, fewer and larger ones.

        Patches are smaller on a small target, so that there are still enough of them.
        """
        low, high = left.to_here(np.array(box[:2])), left.to_here(np.array(box[:2]) + box[2:])
        inset = ROUND_INSET if isinstance(self._target, Surface | Sphere) else None
        settings, side = self._settings, float(np.sqrt(np.prod(high - low)))
        rounds = []
        for larger in (1.0, LARGER):
            half = int(larger * np.clip(side / 8, settings.min_half_px, settings.half_px))
            count = int(settings.patches / larger)
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
        warp, lengths = predicted(pair.rig, left, centre_px, half, length_at)
        height, width = (n // 2**level for n in pair.right_image.shape[:2])
        keep = visible(warp, width, height, 1.5 * half + 4)
        if not keep.any():  # none of none, too
            return _Round(NOTHING, 0.0, np.full(len(keep), Verdict.LEFT_THE_IMAGE))
        warp, lengths = warp.pick(keep), lengths[keep]
        margin = 1.5 * half + reach_px + 6
        low, high = warp.expected_px.min(axis=0) - margin, warp.expected_px.max(axis=0) + margin
        right = Region.of(pair.right_image, level, low * 2**level, high * 2**level)
        local = Warp(warp.centre_px, half, warp.expected_px - right.corner_px, warp.bend, warp.along)
        found = search(left.grey, right.grey, local, reach_px)
        matches = refine(left.grey, right.grey, local, found.shift_px, self._limits)
        verdict = np.where(found.repeated & (matches.verdict == Verdict.MATCHED), Verdict.REPEATED, matches.verdict)
        good = verdict == Verdict.MATCHED
        moved = float(np.median(np.abs(matches.shift_px[good]))) if good.any() else 0.0
        left_px = left.to_full(warp.centre_px[good])
        right_px = right.to_full(local.expected_px[good] + matches.shift_px[good, None] * warp.along[good])
        points = triangulated(pair.rig, left_px, right_px, lengths[good], matches.sigma_px[good] * 2**level)
        return _Round(points, moved, verdict)


def _why(verdict: Array) -> str:
    """What most patches failed by."""
    failed = verdict[verdict != Verdict.MATCHED].astype(int)
    return WHY[Verdict(int(np.bincount(failed).argmax()))] if len(failed) else "too little texture"


def triangulated(rig: Rig, left_px: Array, right_px: Array, start_m: Array, sigma_px: Array) -> Points:
    """Lengths along the left rays: the left pixel is exact by definition, all the error is in the right one."""
    if not len(left_px):
        return NOTHING
    origins, directions = rig.rays(left_px, camera="left")
    lengths = start_m
    for _ in range(2):
        at_px, jacobian = rig.project_with_jacobian(origins + lengths[:, None] * directions, camera="right")
        slope = (jacobian @ directions[:, :, None])[:, :, 0]
        power = np.einsum("ni,ni->n", slope, slope)
        step = np.einsum("ni,ni->n", slope, right_px - at_px) / power
        lengths = lengths / np.maximum(1 - step / lengths, 0.1)  # Newton on 1 / length, in which the pixel is linear
    good = np.isfinite(lengths) & (lengths > 0.02) & (power > 0)
    return Points(origins, directions, lengths, sigma_px / np.sqrt(power)).pick(good)
