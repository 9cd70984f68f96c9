"""A ball ranged by its outline: rays that graze it must pass its centre at one radius.

The outline is looked for where the prediction has it, along normals in the images; each edge becomes a ray in the water
(refraction-true), and the ball is fitted so that every such ray is tangent. It needs contrast, no texture. A known
radius gives the range by the size, from one image if need be; an unknown one is measured, since two outlines also
triangulate the centre.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from leadline.config import OutlineConfig
from leadline.ranging.images import Float32
from leadline.ranging.stereo import Pair
from leadline.rig import Rig, Side
from leadline.samples import Array, Image, Kind, Measurement, Rejected
from leadline.target import Sphere

EDGES = 60  # directions about the ball
LATERAL = 3  # normals that are averaged to one edge
BLUR_RADII, LEAST_BLUR_PX, BLUR_PER_STEP = 1 / 150, 1.0, 0.5  # the scale of the edge filter
SETTLED_M = 1e-5
GROWN_M = 1e-6  # which way and how far a limb moves in the image: good to as much of itself
LEAST_EDGES = 4
LEAST_REACH_PX = 6.0
STRONG = 6.0  # an edge over the noise: the steepest of 20 places of mere noise seldom is
RINGS = np.array([-0.25, -0.18, -0.1, 0.1, 0.18, 0.26])  # radii from the outline, where the two colours are read
SETTLED = 0.3  # of the reach: a ball that moved by less was looked for in the right place
PASSES = 3
ITERATIONS = 15
MAX_CONDITION = 1e7
AGREED_SIGMAS, MIN_AGREED = 3.0, 0.4
SIDES: tuple[Side, ...] = ("left", "right")
ENDS = np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0]])
DARK = 16  # pixels between those that tell whether a picture is all black
TURN = np.stack([f(np.arange(EDGES) * (2 * np.pi / EDGES)) for f in (np.cos, np.sin)], axis=1)

AHEAD, BEHIND = ((np.arange(EDGES) + by) % EDGES for by in (1, -1))


def _slope() -> Float32:
    """(1, K) the derivative of a Gaussian, its sigma in steps."""
    offset = np.arange(-8, 9)
    weight = offset * np.exp(-0.5 * (offset * BLUR_PER_STEP) ** 2)
    return np.asarray(weight / (weight @ offset), np.float32)[None]


SLOPE = _slope()


@dataclass(frozen=True, slots=True)
class _Edges:
    """Edge rays (M, 3), (M, 3), the metres at the ball that a pixel is worth (M,), and the camera's number (M,)."""

    origins_m: Array
    directions: Array
    m_per_px: Array
    camera: Array


class Fitted(NamedTuple):
    """The ball, its covariance (n, n), one sigma of an error common to all edges (blur, shading) (n,), its cameras."""

    ball: Array
    cov: Array
    common: Array
    cameras: frozenset[str]


class OutlineRanger:
    """Measurement ``size`` of a sphere: its centre, and its radius where that is not known."""

    def __init__(self, target: Sphere, settings: OutlineConfig) -> None:
        self._target, self._settings = target, settings

    def measure(self, t_ns: int, pair: Pair, x: Array, sides: Sequence[Side] = SIDES) -> Measurement | Rejected:
        """The ball (3 + k,) from the outlines near a predicted one, or why there is none.

        Looked for closely around the prediction, and only where that holds no ball, farther out.
        """
        wide, close = self._settings.reach
        found = self._settle(pair, sides, x, close)
        if isinstance(found, str):
            found = self._fit(self._edges(pair, sides, x, wide), x)
            found = found if isinstance(found, str) else self._settle(pair, sides, found[0], close)
        if isinstance(found, str):
            return Rejected(Kind.SIZE, t_ns, found)
        ball, cov, common, cameras = found
        eye = np.eye(len(ball))
        return Measurement(Kind.SIZE, t_ns, ball, cov, lambda x: (x, eye), common, cameras)

    def doubted(self, pair: Pair, found: Measurement | Rejected) -> list[Rejected]:
        """A picture that must show all of the ball, and does not show it where the other one does."""
        if isinstance(found, Rejected) or len(found.cameras) != 1:
            return []
        side: Side = "right" if "left" in found.cameras else "left"
        image = pair.left_image if side == "left" else pair.right_image
        ends_px = pair.rig.project_one(found.z[:3] + self._target.radius_m(found.z) * ENDS, side)
        is_whole = bool(((ends_px > 0) & (ends_px < image.shape[1::-1])).all())  # not so where NaN
        if not is_whole or not image[::DARK, ::DARK].any():
            return []
        return [Rejected(Kind.SIZE, found.t_ns, f"the {side} picture does not show it there", camera=side)]

    def _settle(self, pair: Pair, sides: Sequence[Side], ball: Array, reach: float) -> Fitted | str:
        """Fit until the normals start from where the ball is found, so that none is cut short."""
        for _ in range(PASSES):
            found = self._fit(self._edges(pair, sides, ball, reach), ball)
            if isinstance(found, str):
                return found
            moved_m = np.abs(found[0] - ball)
            radius, ball = self._target.radius_m(ball), found[0]
            moved_m[2] *= radius / ball[2]  # as far as it changes the outline
            least = LEAST_REACH_PX * ball[2] / pair.rig.focal_outside_px
            if moved_m.max() < SETTLED * max(reach * radius, least):
                return found
        return "outline does not settle"

    def _edges(self, pair: Pair, sides: Sequence[Side], ball: Array, reach_radii: float) -> _Edges:
        """Sub-pixel edges of all views, of the sign that most of an outline has."""
        images = {"left": pair.left_image, "right": pair.right_image}
        found = [self._trace(pair.rig, images[side], ball, side, reach_radii) for side in sides]
        return _Edges(*(np.concatenate([getattr(edges, name) for edges in found]) for name in _Edges.__slots__))

    def _trace(self, rig: Rig, image: Image, ball: Array, side: Side, reach_radii: float) -> _Edges:
        contour, normal, m_per_px = self._contour(rig, ball, side)
        size_px = self._target.radius_m(ball) / _median(m_per_px)
        reach = max(reach_radii * size_px, LEAST_REACH_PX)
        low, right, bottom = reach + 2, image.shape[1] - reach - 3, image.shape[0] - reach - 3
        x, y = contour[:, 0], contour[:, 1]
        inside = np.flatnonzero((x > low) & (x < right) & (y > low) & (y < bottom))  # not so where NaN
        if len(inside) < LEAST_EDGES:
            return _Edges(np.empty((0, 3)), np.empty((0, 3)), np.empty(0), np.empty(0))
        lines = _beside(contour)[inside], normal[inside]
        step = BLUR_PER_STEP * max(LEAST_BLUR_PX, BLUR_RADII * size_px)
        steps = math.ceil(float(reach) / step)
        t_px = step * np.arange(-steps, steps + 1, dtype=np.float64)
        found, offset_px = _strongest(_profiles(image, *lines, t_px, size_px), t_px)
        kept = inside[found]
        rays = rig.rays(contour[kept] + offset_px[:, None] * normal[kept], side)
        return _Edges(*rays, m_per_px[kept], np.full(len(kept), SIDES.index(side)))

    def _contour(self, rig: Rig, ball: Array, side: Side) -> tuple[Array, Array, Array]:
        """Pixels (N, 2) of the ball's outline, outward normals (N, 2), and the metres (N,) that a pixel is worth."""
        to = ball[:3] if side == "left" else ball[:3] - rig.T_left_right.t_m
        distance = math.hypot(*to)
        radius = self._target.radius_m(ball)
        sine = min(radius / distance, 0.999)
        x, y, z = to / distance
        flat = math.hypot(x, z)
        right, down = np.array([z, 0.0, -x]) / flat, np.array([-x * y, flat**2, -y * z]) / flat
        outward = math.sqrt(1 - sine**2) * (TURN @ np.stack([right, down])) - sine / distance * to
        limb = ball[:3] + radius * outward
        both = rig.project_one(np.concatenate([limb, limb + GROWN_M * outward]), side)  # a Jacobian takes twice as long
        contour, grown = both[:EDGES], (both[EDGES:] - both[:EDGES]) / GROWN_M
        px_per_m = np.sqrt(np.einsum("ni,ni->n", grown, grown))
        return contour, grown / px_per_m[:, None], 1 / px_per_m

    def _miss(self, ball: Array, edges: _Edges) -> tuple[Array, Array]:
        """How far (N,) rays pass outside the ball's surface, and the gradient over the ball (N, 3 + k)."""
        to = ball[:3] - edges.origins_m
        aside = to - np.einsum("ni,ni->n", to, edges.directions)[:, None] * edges.directions
        distance = np.sqrt(np.einsum("ni,ni->n", aside, aside))
        gradient = -np.ones((len(distance), len(ball)))
        gradient[:, :3] = aside / distance[:, None]
        return distance - self._target.radius_m(ball), gradient

    def _fit(self, edges: _Edges, ball: Array) -> Fitted | str:
        """Gauss-Newton with Cauchy weights."""
        if len(edges.m_per_px) < self._settings.min_edges:
            return "too little outline"
        sigma = self._settings.edge_sigma_px * edges.m_per_px
        scale = 10.0
        for _ in range(ITERATIONS):
            miss, gradient = self._miss(ball, edges)
            u = miss / sigma
            weight = 1 / (sigma**2 * (1 + (u / (2 * scale)) ** 2))
            weighted = gradient.T * weight
            information = weighted @ gradient
            solved, step = cv2.solve(information, (weighted @ miss)[:, None])  # NumPy's takes thrice as long
            if not solved:
                return "no round outline"
            ball = ball - step[:, 0]
            before, scale = scale, max(1.0, 1.4826 * _median(np.abs(u)))
            if not np.isfinite(ball).all() or ball[2] <= 0 or self._target.radius_m(ball) <= 0.01:
                return "no round outline"
            if abs(scale - before) < 0.01 * scale and np.abs(step).max() < SETTLED_M:
                break
        agreed = np.abs(u) < AGREED_SIGMAS
        axes = cv2.eigen(information)[1].ravel()  # the largest first
        if agreed.sum() < max(self._settings.min_edges, MIN_AGREED * len(u)) or not axes[0] < MAX_CONDITION * axes[-1]:
            return "no round outline"
        inverse = np.asarray(cv2.invert(information)[1], np.float64)
        common = inverse @ (weighted @ edges.m_per_px) * self._settings.bias_sigma_px
        cov = np.asarray(inverse * scale**2) + np.outer(common, common)
        return Fitted(ball, cov, common, _hangs_on(edges.camera, agreed, self._settings.min_edges / 2))


def _hangs_on(camera: Array, agreed: NDArray[np.bool_], least: float) -> frozenset[str]:
    """The camera whose edges alone agree on the ball; none where those of both do, both where none's do."""
    of = [camera == i for i in range(len(SIDES))]
    good = [(agreed & one).sum() >= max(least, MIN_AGREED * one.sum()) for one in of]
    return frozenset() if all(good) else frozenset(s for s, g in zip(SIDES, good, strict=True) if g or not any(good))


def _median(values: Array) -> float:
    """NumPy's own takes ten times as long on a hundred numbers."""
    return float(np.partition(values, len(values) // 2)[len(values) // 2])


def _beside(contour: Array) -> Array:
    """(N, LATERAL, 2) each point of a closed curve with points beside it, a part of the way to its neighbours."""
    ahead, behind = contour[AHEAD], contour[BEHIND]
    s = ((np.arange(LATERAL) - LATERAL // 2) / LATERAL)[:, None]
    return np.asarray(
        contour[:, None] + s / 2 * (ahead - behind)[:, None] + s**2 / 2 * (ahead - 2 * contour + behind)[:, None]
    )


def _profiles(image: Image, start: Array, normal: Array, t_px: Array, size_px: float) -> Float32:
    """Grey levels (N, T) along normals, in the mix of colours that tells the ball best from what is around it."""
    t = np.concatenate([t_px, size_px * RINGS]).astype(np.float32)
    start, normal = start.astype(np.float32), normal.astype(np.float32)
    x, y = ((start[..., i, None] + normal[:, i, None, None] * t).reshape(-1, len(t)) for i in (0, 1))
    looked_up = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    seen: Float32 = looked_up.astype(np.float32)
    if image.ndim == 3:
        seen = np.asarray(cv2.transform(seen, _contrast(seen[:, len(t_px) :])), np.float32)
    first, *others = (seen[i::LATERAL, : len(t_px)] for i in range(LATERAL))
    for other in others:
        first = first + other
    return first


def _contrast(rings: Float32) -> Array:
    """(1, 3) mix of the colours by which the inner rings stand out best from the outer ones (Fisher's discriminant)."""
    half = len(RINGS) // 2
    means: list[Array] = []
    within = 4.0 * np.eye(3)  # 2 grey levels: no colour is free of noise
    for side in (rings[:, :half].reshape(-1, 3), rings[:, half:].reshape(-1, 3)):
        mean = np.ones(len(side), np.float32) @ side / len(side)
        off = side - mean
        within += off.T @ off / len(side)
        means.append(mean)
    mix = np.asarray(cv2.solve(within, (means[0] - means[1]).astype(np.float64)[:, None])[1], np.float64).T
    length = math.hypot(*mix[0].tolist())
    return np.full((1, 3), 1 / 3) if length == 0 else mix / length  # 0: a black picture


def _strongest(profile: Float32, t_px: Array) -> tuple[NDArray[np.intp], Array]:
    """Which normals (M,) have an edge that stands out, and the offset (M,) px of the strongest one along each."""
    slope = cv2.filter2D(profile, cv2.CV_32F, SLOPE, borderType=cv2.BORDER_REPLICATE)
    quarter = len(t_px) // 4
    if slope[:, quarter:-quarter].sum() < 0:
        slope = -slope
    best = slope[:, 1:-1].argmax(axis=1) + 1
    rows = np.arange(len(best))
    low, mid, high = slope[rows, best - 1], slope[rows, best], slope[rows, best + 1]
    curvature = low - 2 * mid + high
    # The flattest quarter of a profile is noise, however wide its edge.
    strong = mid > STRONG * np.partition(np.abs(slope), quarter, axis=1)[:, quarter]
    found = np.flatnonzero(strong & (curvature < 0) & (best >= 3) & (best <= len(t_px) - 4))
    shift = 0.5 * (low - high)[found] / curvature[found]
    return found, t_px[best[found]] + shift * (t_px[1] - t_px[0])
