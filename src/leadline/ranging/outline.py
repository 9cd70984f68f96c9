"""A ball ranged by its outline: rays that graze it must pass its centre at one radius.

The outline is looked for where the prediction has it, along normals in both images; each edge pixel becomes a ray in
the water (refraction-true), and the ball is fitted so that every such ray is tangent. It needs contrast, no texture. A
known radius gives the range by the size; an unknown one is measured, since two outlines also triangulate the centre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from leadline.config import OutlineConfig
from leadline.ranging.images import Float32, Spline, grey
from leadline.ranging.stereo import Pair
from leadline.rig import Rig, Side
from leadline.samples import Array, Image, Kind, Measurement, Rejected
from leadline.target import Sphere

DIRECTIONS = 180
STEP_PX = 0.5
INSIDE, OUTSIDE = (0.75, 0.82, 0.9), (1.1, 1.18, 1.26)  # rings, in radii, that show the two colours
ITERATIONS = 10
NEIGHBOURS = 3  # an edge is averaged over three normals, so that as many share their noise
MAX_CONDITION = 1e7
MIN_AGREED = 0.4


def _pixels(image: Image, q_px: Array) -> Array:
    """Colours (M, 3) of the whole pixels at points that lie inside the image."""
    inside = np.isfinite(q_px).all(axis=1) & ((q_px >= 0) & (q_px < [image.shape[1] - 1, image.shape[0] - 1])).all(
        axis=1
    )
    columns, rows = np.round(q_px[inside]).astype(int).T
    return np.asarray(image[rows, columns], float)


@dataclass(frozen=True, slots=True)
class _Edges:
    """Edge rays of one camera (M, 3), (M, 3) and the metres at the ball that a pixel is worth (M,)."""

    origins_m: Array
    directions: Array
    m_per_px: Array


class OutlineRanger:
    """Measurement ``size`` of a sphere: its centre, and its radius where that is not known."""

    def __init__(self, rig: Rig, target: Sphere, settings: OutlineConfig) -> None:
        self._rig, self._target, self._settings = rig, target, settings

    def measure(self, t_ns: int, pair: Pair, x: Array) -> Measurement | Rejected:
        """The ball (3 + k,) from both outlines near a predicted one, or why there is none."""
        fitted = x
        for reach in self._settings.reach:  # wide first, then close, when the normals start from the right place
            edges = [
                self._edges(pair.left_image, fitted, "left", reach),
                self._edges(pair.right_image, fitted, "right", reach),
            ]
            origins, directions = (np.concatenate([getattr(e, n) for e in edges]) for n in ("origins_m", "directions"))
            m_per_px = np.concatenate([e.m_per_px for e in edges])
            if len(m_per_px) < self._settings.min_edges:
                return Rejected(Kind.SIZE, t_ns, "too little outline")
            result = self._fit(origins, directions, m_per_px, fitted)
            if result is None:
                return Rejected(Kind.SIZE, t_ns, "no round outline")
            fitted, cov = result
        eye = np.eye(len(fitted))
        return Measurement(Kind.SIZE, t_ns, fitted, cov, lambda x: (x, eye))

    def _contour(self, ball: Array, side: Side, grow: float) -> Array:
        """Pixels (DIRECTIONS, 2) of the ball's outline, its radius grown by a factor."""
        pupil = np.zeros(3) if side == "left" else self._rig.T_left_right.t_m
        to = ball[:3] - pupil
        distance = float(np.linalg.norm(to))
        radius = self._target.radius_m(ball) * grow
        sine = min(radius / distance, 0.999)
        across = np.linalg.svd(to[None])[2][1:]
        turn = np.linspace(0, 2 * np.pi, DIRECTIONS, endpoint=False)
        ring = np.cos(turn)[:, None] * across[0] + np.sin(turn)[:, None] * across[1]
        points = ball[:3] - to * sine**2 + radius * np.sqrt(1 - sine**2) * ring
        return self._rig.project(points)[0 if side == "left" else 1]

    def _contrast(self, image: Image, ball: Array, side: Side) -> Float32:
        """The mix of colours in which the ball stands out best from what is around it (Fisher's discriminant)."""
        if image.ndim == 2:
            return image.astype(np.float32)
        rings = [
            np.concatenate([_pixels(image, self._contour(ball, side, grow)) for grow in factors])
            for factors in (INSIDE, OUTSIDE)
        ]
        if min(len(ring) for ring in rings) < 20:
            return grey(image)
        within = sum(np.cov(ring.T) for ring in rings) + 4.0 * np.eye(3)  # 2 grey levels: no colour is free of noise
        mix = np.linalg.solve(within, rings[0].mean(axis=0) - rings[1].mean(axis=0))
        length = float(np.linalg.norm(mix))
        return grey(image) if length == 0 else np.asarray(image @ (mix / length), np.float32)  # a black picture

    def _edges(self, colour: Image, ball: Array, side: Side, reach_radii: float) -> _Edges:
        """Sub-pixel edges along the outline's normals, of the sign that most of the outline has."""
        image = self._contrast(colour, ball, side)
        inner, contour, outer = (self._contour(ball, side, g) for g in (0.99, 1.0, 1.01))
        normal = outer - inner
        nothing = _Edges(np.empty((0, 3)), np.empty((0, 3)), np.empty(0))
        if not np.isfinite(normal).all(axis=1).any():
            return nothing
        size_px = float(np.nanmedian(np.linalg.norm(normal, axis=1))) / 0.02
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        reach = max(reach_radii * size_px, 5.0)
        height, width = image.shape
        inside = np.isfinite(contour).all(axis=1) & (
            (contour > reach + 4) & (contour < [width - reach - 5, height - reach - 5])
        ).all(axis=1)
        contour, normal = contour[inside], normal[inside]
        if len(contour) < 8:
            return nothing
        offset_px = self._strongest(image, contour, normal, reach, max(1.0, size_px / 150))
        found = np.isfinite(offset_px)
        at = contour[found] + offset_px[found, None] * normal[found]
        origins, directions = self._rig.rays(at, side)
        half = 0.5 * normal[found]
        m_per_px = np.abs(
            self._miss(ball, *self._rig.rays(at + half, side))[0]
            - self._miss(ball, *self._rig.rays(at - half, side))[0]
        )
        return _Edges(origins, directions, m_per_px)

    @staticmethod
    def _strongest(image: Float32, contour: Array, normal: Array, reach: float, blur_px: float) -> Array:
        """Offset (M,) of the strongest edge along each normal; NaN where none stands out."""
        t = np.arange(-reach, reach + STEP_PX / 2, STEP_PX)
        along = contour[:, None] + t[None, :, None] * normal[:, None]
        spline = Spline.of(image, along.reshape(-1, 2), 3)
        profile = np.asarray(spline.sample(along[..., 0], along[..., 1]), float)
        slope = ndimage.gaussian_filter1d(profile, blur_px / STEP_PX, axis=1, order=1)
        slope = ndimage.uniform_filter1d(slope, 3, axis=0, mode="nearest")
        sign = np.sign(np.nansum(slope[:, len(t) // 4 : -len(t) // 4]))
        slope = slope * (sign or 1.0)
        best = np.clip(np.nan_to_num(slope, nan=-1.0).argmax(axis=1), 1, len(t) - 2)
        rows = np.arange(len(best))
        low, mid, high = slope[rows, best - 1], slope[rows, best], slope[rows, best + 1]
        curvature = low - 2 * mid + high
        shift = np.where(curvature < 0, 0.5 * (low - high) / np.where(curvature < 0, curvature, 1), np.nan)
        strong = mid > 3 * np.nanmedian(np.abs(slope), axis=1)
        at_end = (best < 3) | (best > len(t) - 4)
        return np.asarray(np.where(strong & ~at_end, t[best] + shift * STEP_PX, np.nan))

    def _miss(self, ball: Array, origins_m: Array, directions: Array) -> tuple[Array, Array]:
        """How far (N,) rays pass outside the ball's surface, and the gradient over the ball (N, 3 + k)."""
        to = ball[:3] - origins_m
        aside = to - np.einsum("ni,ni->n", to, directions)[:, None] * directions
        distance = np.linalg.norm(aside, axis=1)
        gradient = np.column_stack([aside / distance[:, None], *[-np.ones(len(distance))] * (len(ball) - 3)])
        return distance - self._target.radius_m(ball), gradient

    def _fit(self, origins_m: Array, directions: Array, m_per_px: Array, ball: Array) -> tuple[Array, Array] | None:
        """Gauss-Newton with Cauchy weights; a bias common to all edges (blur, shading) stays in the covariance."""
        sigma = self._settings.edge_sigma_px * m_per_px
        scale = 10.0
        for _ in range(ITERATIONS):
            miss, gradient = self._miss(ball, origins_m, directions)
            u = miss / sigma
            weight = 1 / (sigma**2 * (1 + (u / (2 * scale)) ** 2))
            information = (gradient * weight[:, None]).T @ gradient
            if np.linalg.cond(information) > MAX_CONDITION:
                return None
            ball = ball - np.linalg.solve(information, gradient.T @ (weight * miss))
            scale = max(1.0, 1.4826 * float(np.median(np.abs(u))))
            if not np.isfinite(ball).all() or ball[2] <= 0 or self._target.radius_m(ball) <= 0.01:
                return None
        if np.mean(np.abs(u) < 3) < MIN_AGREED:
            return None
        inverse = np.linalg.inv(information)
        common = inverse @ (gradient.T @ (weight * m_per_px)) * self._settings.bias_sigma_px
        return ball, inverse * scale**2 * NEIGHBOURS + np.outer(common, common)
