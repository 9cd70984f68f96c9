"""What a frame is expected to say of a target: the localizer's own measurements, before there is any picture.

Patches, outline and spot are put where the rig would see them, with the noise that the stated conditions give them, and
go through the localizer's own fits: their covariances are those that the localizer will state.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from leadline.config import BeamConfig, OutlineConfig, StereoConfig
from leadline.estimation import Estimate
from leadline.geometry import Camera
from leadline.localizer.motion import Skew
from leadline.localizer.sight import Found, Sight
from leadline.ranging.beam import BeamRanger
from leadline.ranging.coarse import Box
from leadline.ranging.focus import narrowed
from leadline.ranging.images import Region
from leadline.ranging.layout import (
    CHOICES,
    Prediction,
    cells,
    levels,
    patch_size,
    predicted,
    round_inset,
    shared,
    visible,
)
from leadline.ranging.shape_fit import Points, fit
from leadline.ranging.stereo import ENOUGH, LARGER
from leadline.ranging.surface_fit import fit_surface
from leadline.rig import Rig, Side
from leadline.samples import Array, Kind, Measurement, StereoFrame
from leadline.target import Cylinder, Plane, Sphere, Surface, Target

SIDES: tuple[Side, Side] = ("left", "right")
SURFACE_RADIUS_M = 0.2  # of the piece of an unknown surface that the box is taken to show
MARGIN_PX = 4.0  # from the border of an image
MATCHED = 0.86  # of the texture that a match can use: by its blur, and its free slants, gain and level
ROOMY, CRAMPED, MOST = 6.0, 0.11, 3.0  # on a target fewer patches wide, by how much less with each, up to so many
_THIRDS = (np.arange(CHOICES) + 0.5) / CHOICES - 0.5
PLACES = np.stack(np.meshgrid(_THIRDS, _THIRDS), axis=-1).reshape(-1, 2)  # that are tried in a cell, in its sides
EDGES = 60  # directions about a ball


@dataclass(frozen=True, slots=True)
class Conditions:
    """What the pictures will be like. The defaults are those of the simulator's clear pool, a ball grown over a little.

    noise_grey: standard deviation of a pixel, grey levels of 255. texture_grey_px: RMS of the target's grey levels'
    slope along a row, about its mean over a patch (shading is no texture), per pixel of the matched image, from close
    by; it falls by exp(-attenuation distance), which is water and lens together. unlike_px_per_rad: error of a patch,
    full-size pixels, for every radian between the directions that the cameras see it from: what two views of one
    surface do not share (slant, shading). It rules from close by. spot_px: of the spot's centre in one image.
    frames_hz, readings_hz, seconds: how long the filter has seen the target.
    """

    noise_grey: float = 1.6
    texture_grey_px: float = 2.7
    attenuation_per_m: float = 0.1
    unlike_px_per_rad: float = 0.34
    spot_px: float = 0.07
    frames_hz: float = 10.0
    readings_hz: float = 3.0
    seconds: float = 2.0

    def match_sigma_px(
        self, distance_m: float, parallax_rad: float, side_px: float, level: int, wide: float = ROOMY
    ) -> float:
        """Of one patch's shift, pixels of the level: the noise limit (both images' noise over the patch's texture), and
        what the two views do not share. wide: the target, in patches.

        A texture looks alike at all scales, so that its slope per pixel of the shrunk image is the same; the noise is
        averaged by shrinking.
        """
        texture = self.texture_grey_px * float(np.exp(-self.attenuation_per_m * distance_m))
        matched = MATCHED * (1 - CRAMPED * min(max(ROOMY - wide, 0.0), MOST))
        noise_px = np.sqrt(2) * self.noise_grey / 2**level / (matched * texture * side_px)
        return float(np.hypot(noise_px, self.unlike_px_per_rad * parallax_rad / 2**level))


def vector_at(target: Target, nearest_m: Array) -> Array:
    """The target's vector (3 + k,) when its nearest point is there; what is unknown of its shape is as expected."""
    x = np.concatenate([nearest_m, target.shape_mean])
    if isinstance(target, Sphere | Cylinder):
        x[:3] *= 1 + target.radius_m(x) / float(np.linalg.norm(nearest_m))
    return x


def box_of(rig: Rig, target: Target, x: Array, side: Side = "left") -> Box | None:
    """The target's box in an image, clipped to it; None where it is not in view. A wall or a pile is the whole view."""
    camera = rig.left if side == "left" else rig.right
    if isinstance(target, Plane | Cylinder):
        return 0.0, 0.0, float(camera.width), float(camera.height)
    q_px = rig.project(_outline_points(target, x))[SIDES.index(side)]
    q_px = q_px[np.isfinite(q_px).all(axis=1)]
    if not len(q_px):
        return None
    low = np.clip(q_px.min(axis=0), 0, [camera.width, camera.height])
    high = np.clip(q_px.max(axis=0), 0, [camera.width, camera.height])
    width, height = (float(v) for v in high - low)
    return (float(low[0]), float(low[1]), width, height) if min(width, height) >= 2 else None


def _outline_points(target: Target, x: Array) -> Array:
    """Points (N, 3) on the visible rim of a ball, or of a piece of an unknown surface."""
    return _rim(target, x, 90) if isinstance(target, Sphere) else x[:3] + SURFACE_RADIUS_M * _ring(x[:3], 90)


def _rim(ball: Sphere, x: Array, count: int) -> Array:
    """Points (N, 3) where rays from the origin graze the ball."""
    radius = ball.radius_m(x)
    sine = min(radius / float(np.linalg.norm(x[:3])), 0.999)
    return np.asarray(x[:3] * (1 - sine**2) + radius * np.sqrt(1 - sine**2) * _ring(x[:3], count))


def _ring(towards: Array, count: int) -> Array:
    """Unit vectors (N, 3) all around a direction, across it."""
    turn = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.asarray(np.stack([np.cos(turn), np.sin(turn)], axis=1) @ np.linalg.svd(towards[None])[2][1:])


def _expected(kind: Kind, z: Array, cov: Array, common: Array | None = None) -> Measurement:
    eye = np.eye(len(z))
    return Measurement(kind, 0, z, cov, lambda x: (x, eye), common)


def expected_stereo(
    rig: Rig, target: Target, settings: StereoConfig, conditions: Conditions, x: Array
) -> Measurement | None:
    """The shape through the patches that both cameras see; None where there are too few, or too uncertain ones."""
    points = expected_points(rig, target, settings, conditions, x)
    if points is None:
        return None
    if isinstance(target, Surface):
        beam = None if rig.laser is None else (rig.laser.origin_m, rig.laser.direction)
        sheet = fit_surface(points, beam)
        return None if sheet is None else _expected(Kind.STEREO, x, sheet.cov)
    found = fit(target, points, x, settings.roughness_m)
    return None if found is None else _expected(Kind.STEREO, x, found.cov)


def expected_points(
    rig: Rig, target: Target, settings: StereoConfig, conditions: Conditions, x: Array
) -> Points | None:
    """Patches' middles on the target, exact, with the sigma that they will have."""
    box = box_of(rig, target, x)
    if box is None:
        return None
    if isinstance(target, Cylinder):
        box = narrowed(rig, target, x, box)
    distance, _ = target.range(x)
    _, level = levels(settings, rig.focal_outside_px, box, distance)
    rounds = []
    for larger in (1.0, LARGER):  # as the ranger does
        size_px = np.array(box[2:]) / 2**level
        half, count = patch_size(settings, size_px, level, larger)
        tried, expected = _patches(rig, target, x, box, level, half, count)
        side_px, wide_px = 2 * half + 1, float(np.sqrt(np.prod(size_px)))
        sigma_px = conditions.match_sigma_px(distance, rig.baseline_m / distance, side_px, level, wide_px / side_px)
        rounds.append((expected, half, sigma_px, len(expected.length_m) / sigma_px**2))
        if len(expected.length_m) > ENOUGH * tried:
            break
    expected, half, sigma_px, _ = max(rounds, key=lambda one: one[-1])
    if len(expected.length_m) < settings.min_agreed or sigma_px > settings.max_sigma_px:
        return None
    sigma_m = sigma_px * expected.length_m**2 / expected.rate_px_m
    common = shared(expected.warp.centre_px, 2 * half + 1)
    return Points(expected.origins_m, expected.directions, expected.length_m, sigma_m, common)


def _patches(rig: Rig, target: Target, x: Array, box: Box, level: int, half: int, count: int) -> tuple[int, Prediction]:
    """How many are tried, and those that stand wholly on what both cameras see of the target."""
    whole = Region(np.empty((0, 0), np.float32), np.zeros(2), level)
    low, high = whole.to_here(np.array(box[:2])), whole.to_here(np.array(box[:2]) + box[2:])
    centre_px = _grid(low + half / 2, high - half / 2, half, count, round_inset(target))
    expected = predicted(rig, whole, centre_px, half, lambda origins, v: target.beam_length(x, origins, v)[0])
    keep = visible(expected.warp, rig.right.width // 2**level, rig.right.height // 2**level, 1.5 * half + 4)
    left_px = np.array([rig.left.width, rig.left.height]) // 2**level
    keep &= ((centre_px > half) & (centre_px < left_px - half - 1)).all(axis=1)
    return len(centre_px), expected.pick(keep)


def _inside(q_px: Array, camera: Camera, margin_px: float) -> NDArray[np.bool_]:
    """Which pixels (N, 2) are so far inside an image; not those that are NaN."""
    return np.asarray(((q_px > margin_px) & (q_px < np.array([camera.width, camera.height]) - margin_px)).all(axis=1))


def _grid(low_px: Array, high_px: Array, half: int, count: int, inset: float | None) -> Array:
    """About so many patch middles (N, 2) between two corners, or in the ellipse there, one in each of the ``cells``.

    On the limb of what is round the ranger finds the richest of the places that it tries farthest out: the limb itself.
    """
    size = high_px - low_px
    columns, rows = cells(size, half, count)
    middles = np.stack(np.meshgrid(*[(np.arange(n) + 0.5) / n for n in (columns, rows)]), axis=-1).reshape(-1, 1, 2)
    tried = middles + PLACES / [columns, rows]
    out = np.linalg.norm(2 * tried - 1, axis=2)
    inside = out < (np.inf if inset is None else inset)
    at = np.where(inside.all(axis=1), len(PLACES) // 2, np.where(inside, out, -1.0).argmax(axis=1))
    part = tried[np.arange(len(tried)), at][inside.any(axis=1)]
    return np.asarray(low_px + part * size)


def expected_size(rig: Rig, target: Target, settings: OutlineConfig, x: Array) -> Measurement | None:
    """The ball through the rays that graze it; None where too little of its outline is in view."""
    if not isinstance(target, Sphere):
        return None
    gradients, weights, m_per_px = [], [], []
    for side in SIDES:
        gradient, worth = _grazing(rig, target, settings, x, side)
        gradients.append(gradient)
        m_per_px.append(worth)
        weights.append(1 / (settings.edge_sigma_px * worth) ** 2)
    gradient, weight, worth = np.concatenate(gradients), np.concatenate(weights), np.concatenate(m_per_px)
    if len(worth) < settings.min_edges:
        return None
    inverse = np.linalg.inv((gradient.T * weight) @ gradient)
    common = inverse @ (gradient.T @ (weight * worth)) * settings.bias_sigma_px
    return _expected(Kind.SIZE, x, inverse + np.outer(common, common), common)


def _grazing(rig: Rig, target: Sphere, settings: OutlineConfig, x: Array, side: Side) -> tuple[Array, Array]:
    """Of the edges that one image shows: how their miss depends on the ball (N, 3 + k), and metres a pixel (N,)."""
    pupil = np.zeros(3) if side == "left" else rig.T_left_right.t_m
    ball = np.concatenate([x[:3] - pupil, x[3:]])
    rim = _rim(target, ball, EDGES)
    outward = (rim - ball[:3]) / target.radius_m(x)
    q_px, jacobian = rig.project_with_jacobian(rim + pupil, side)
    worth = 1 / np.linalg.norm(np.einsum("nij,nj->ni", jacobian, outward), axis=1)
    if np.isnan(worth).all():  # a ball that reaches behind the port
        return np.empty((0, len(x))), worth[:0]
    reach_px = max(min(settings.reach) * target.radius_m(x) / float(np.nanmedian(worth)), 5.0) + 3
    seen = _inside(q_px, rig.left if side == "left" else rig.right, reach_px)
    return np.column_stack([-outward[seen], *[-np.ones(seen.sum())] * len(x[3:])]), worth[seen]


def expected_spot(
    rig: Rig, target: Target, ranger: BeamRanger, settings: BeamConfig, conditions: Conditions, x: Array
) -> Measurement | None:
    """The beam's length by its spot in those images that show it; None where none does, or the beam misses."""
    assert rig.laser is not None
    length = float(target.beam_length(x, rig.laser.origin_m[None], rig.laser.direction[None])[0][0])
    if not np.isfinite(length):
        return None
    point = (rig.laser.origin_m + length * rig.laser.direction)[None]
    cov = conditions.spot_px**2 * np.eye(2)
    margin_px = 3 * settings.spot_radius_m * rig.focal_outside_px / length + MARGIN_PX
    seen: dict[Side, tuple[Array, Array]] = {}
    for side, q_px, camera in zip(SIDES, rig.project(point), (rig.left, rig.right), strict=True):
        if _inside(q_px, camera, margin_px)[0]:
            seen[side] = (q_px[0], cov)
    found = ranger.spot(0, seen) if seen else None
    return found if isinstance(found, Measurement) else None


class ExpectedSight(Sight):
    """In the place of the localizer's eyes: the same expected measurements in every frame, each with fresh noise."""

    def __init__(self, sight: Sight, seed: int) -> None:
        vars(self).update(vars(sight))  # its tables take long to make
        self.expected: list[Measurement] = []
        self._rng = np.random.default_rng(seed)
        self._common = float(self._rng.standard_normal())  # one error of all outlines

    def measure(self, frame: StereoFrame, box: Box, before: Estimate | None, skew: Skew) -> Found:
        return [self._noisy(one, frame.t_ns, skew) for one in self.expected]

    def _noisy(self, one: Measurement, t_ns: int, skew: Skew) -> Measurement:
        common = np.zeros(len(one.z)) if one.common is None else one.common
        noise = np.linalg.cholesky(one.cov - np.outer(common, common)) @ self._rng.standard_normal(len(one.z))
        drawn = replace(one, t_ns=t_ns, z=one.z + noise + self._common * common)
        return drawn if one.kind is Kind.SPOT else self._honest(drawn, skew)
