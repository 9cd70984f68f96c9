"""A ball of known size ranged by its outline: rays that graze it must pass its centre at one radius.

The outline is looked for where the prediction has it, along normals in both images; each edge pixel becomes a ray in the
water (refraction-true), and the centre is fitted so that every such ray is tangent. Texture is not needed, contrast is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from leadline.ranging.images import Float32, Spline, grey
from leadline.ranging.stereo import Pair
from leadline.rig import Rig, Side
from leadline.samples import Array, Image, Kind, Measurement, Rejected
from leadline.target import Sphere

DIRECTIONS = 180
STEP_PX = 0.5
INSIDE, OUTSIDE = (0.75, 0.82, 0.9), (1.1, 1.18, 1.26)  # rings, in radii, that show the two colours
ITERATIONS = 4


@dataclass(frozen=True, slots=True)
class OutlineSettings:
    """``config.OutlineConfig`` documents these."""

    reach: tuple[float, ...] = (0.15, 0.05)
    min_edges: int = 40
    edge_sigma_px: float = 0.3
    bias_sigma_px: float = 0.4


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
    """Measurement ``size`` for a sphere whose diameter is known."""

    def __init__(self, rig: Rig, target: Sphere, settings: OutlineSettings) -> None:
        if target.diameter_m is None:
            raise ValueError("an outline gives a range only for a sphere of known diameter")
        self._rig, self._radius_m, self._settings = rig, target.diameter_m / 2, settings

    def measure(self, t_ns: int, pair: Pair, centre_m: Array) -> Measurement | Rejected:
        """The centre (3,) from both outlines near a predicted centre, or why there is none."""
        fitted = centre_m
        for reach in self._settings.reach:  # wide first, then close, when the normals start from the right place
            edges = [
                self._edges(pair.left_image, fitted, "left", reach),
                self._edges(pair.right_image, fitted, "right", reach),
            ]
            rays = [
                np.concatenate([getattr(e, name) for e in edges]) for name in ("origins_m", "directions", "m_per_px")
            ]
            if len(rays[2]) < self._settings.min_edges:
                return Rejected(Kind.SIZE, t_ns, "too little outline")
            result = self._fit(*rays, fitted)
            if result is None:
                return Rejected(Kind.SIZE, t_ns, "no round outline")
            fitted, cov = result
        eye = np.eye(3)
        return Measurement(Kind.SIZE, t_ns, fitted, cov, lambda x: (x[:3], eye))

    def _contour(self, centre_m: Array, side: Side, grow: float) -> Array:
        """Pixels (DIRECTIONS, 2) of the ball's outline, its radius grown by a factor."""
        pupil = np.zeros(3) if side == "left" else self._rig.T_left_right.t_m
        to = centre_m - pupil
        distance = float(np.linalg.norm(to))
        radius = self._radius_m * grow
        sine = min(radius / distance, 0.999)
        across = np.linalg.svd(to[None])[2][1:]
        turn = np.linspace(0, 2 * np.pi, DIRECTIONS, endpoint=False)
        ring = np.cos(turn)[:, None] * across[0] + np.sin(turn)[:, None] * across[1]
        points = centre_m - to * sine**2 + radius * np.sqrt(1 - sine**2) * ring
        return self._rig.project(points)[0 if side == "left" else 1]

    def _contrast(self, image: Image, centre_m: Array, side: Side) -> Float32:
        """The mix of colours in which the ball stands out best from what is around it (Fisher's discriminant)."""
        if image.ndim == 2:
            return image.astype(np.float32)
        rings = [
            np.concatenate([_pixels(image, self._contour(centre_m, side, grow)) for grow in factors])
            for factors in (INSIDE, OUTSIDE)
        ]
        if min(len(ring) for ring in rings) < 20:
            return grey(image)
        within = sum(np.cov(ring.T) for ring in rings) + 4.0 * np.eye(3)  # 2 grey levels: no colour is free of noise
        mix = np.linalg.solve(within, rings[0].mean(axis=0) - rings[1].mean(axis=0))
        return np.asarray(image @ (mix / np.linalg.norm(mix)), np.float32)

    def _edges(self, colour: Image, centre_m: Array, side: Side, reach_radii: float) -> _Edges:
        """Sub-pixel edges along the outline's normals, of the sign that most of the outline has."""
        image = self._contrast(colour, centre_m, side)
        inner, contour, outer = (self._contour(centre_m, side, g) for g in (0.99, 1.0, 1.01))
        normal = outer - inner
        size_px = float(np.nanmedian(np.linalg.norm(normal, axis=1))) / 0.02
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        reach = max(reach_radii * size_px, 5.0)
        height, width = image.shape
        inside = np.isfinite(contour).all(axis=1) & (
            (contour > reach + 4) & (contour < [width - reach - 5, height - reach - 5])
        ).all(axis=1)
        contour, normal = contour[inside], normal[inside]
        if len(contour) < 8:
            return _Edges(np.empty((0, 3)), np.empty((0, 3)), np.empty(0))
        offset_px = self._strongest(image, contour, normal, reach, max(1.0, size_px / 150))
        found = np.isfinite(offset_px)
        at = contour[found] + offset_px[found, None] * normal[found]
        origins, directions = self._rig.rays(at, side)
        half = 0.5 * normal[found]
        m_per_px = np.abs(
            self._miss(centre_m, *self._rig.rays(at + half, side))[0]
            - self._miss(centre_m, *self._rig.rays(at - half, side))[0]
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

    @staticmethod
    def _miss(centre_m: Array, origins_m: Array, directions: Array) -> tuple[Array, Array]:
        """Distance (N,) at which rays pass a centre, and its gradient over the centre (N, 3)."""
        to = centre_m - origins_m
        aside = to - np.einsum("ni,ni->n", to, directions)[:, None] * directions
        distance = np.linalg.norm(aside, axis=1)
        return distance, aside / distance[:, None]

    def _fit(self, origins_m: Array, directions: Array, m_per_px: Array, centre_m: Array) -> tuple[Array, Array] | None:
        """Gauss-Newton with Cauchy weights; a bias common to all edges (blur, shading) stays in the covariance."""
        sigma = self._settings.edge_sigma_px * m_per_px
        bias = self._settings.bias_sigma_px
        scale = 10.0
        for _ in range(ITERATIONS + 6):
            distance, gradient = self._miss(centre_m, origins_m, directions)
            u = (distance - self._radius_m) / sigma
            weight = 1 / (sigma**2 * (1 + (u / (2 * scale)) ** 2))
            information = (gradient * weight[:, None]).T @ gradient
            if np.linalg.cond(information) > 1e6:
                return None
            centre_m = centre_m - np.linalg.solve(information, gradient.T @ (weight * (distance - self._radius_m)))
            scale = max(1.0, 1.4826 * float(np.median(np.abs(u))))
        if np.mean(np.abs(u) < 3) < 0.4:
            return None
        inverse = np.linalg.inv(information)
        common = inverse @ (gradient.T @ (weight * m_per_px)) * bias
        neighbours = 3  # edges are averaged over three normals
        return centre_m, inverse * scale**2 * neighbours + np.outer(common, common)
