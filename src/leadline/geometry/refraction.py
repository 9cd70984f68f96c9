"""A camera behind a stack of flat, parallel layers (a flat port), and water or air beyond.

In the plane of incidence, with the ray's slope q = tan(angle to the normal) in the air before the port, a layer of
index m and thickness t moves the ray sideways by t * q * w, w = 1 / sqrt(m^2 + (m^2 - 1) q^2) (Snell's law). A point at
distance r from the normal through the pupil is seen where the sum over air, layers and water equals r. Divided by r,
with q = s r:

    g(s) = s * sum_i t_i w_i(s^2 r^2) - 1 = 0

g is concave and increasing, so Newton's method climbs to the root without overshooting once it is below, and nothing is
singular on the axis (r = 0). It starts from the series about the paraxial s = 1 / sum(t_i / m_i). Compare Agrawal et
al., CVPR 2012 (flat refractive geometry).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from leadline.geometry.arrays import as_rows, as_unit, chunks
from leadline.geometry.camera import Camera
from leadline.geometry.pose import Pose
from leadline.samples import Array

_STEPS = 60  # a bound only: three to six are taken, more for rays that graze the port
_MOST_RISE = 0.3  # of the start over the paraxial slope; beyond, the series says little
_SETTLED = 1e-8  # a relative step below this leaves an error of its square


@dataclass(frozen=True, slots=True, eq=False)
class LayeredPort:
    """Flat layers between the camera's air and the outside.

    normal: unit (3,), camera frame, towards the outside. distance_m: from the entrance pupil to the first face, along
    the normal. layers: (thickness_m, index) from the inside out, any number. ValueError for a normal that is not a unit
    vector, a negative distance or thickness, or an index below 1.
    """

    normal: Array
    distance_m: float
    layers: tuple[tuple[float, float], ...]
    outside_index: float

    def __init__(
        self, normal: ArrayLike, distance_m: float, layers: ArrayLike | tuple[()] = (), outside_index: float = 1.0
    ) -> None:
        stack = tuple(
            (float(thickness), float(index)) for thickness, index in np.asarray(layers, np.float64).reshape(-1, 2)
        )
        object.__setattr__(self, "normal", as_unit(normal, "normal"))
        object.__setattr__(self, "distance_m", float(distance_m))
        object.__setattr__(self, "layers", stack)
        object.__setattr__(self, "outside_index", float(outside_index))
        for name, length in [
            ("distance_m", self.distance_m),
            *((f"layers[{i}].thickness_m", t) for i, (t, _) in enumerate(stack)),
        ]:
            if not 0 <= length < np.inf:
                raise ValueError(f"{name}: must be a finite length of 0 or more")
        for name, index in [
            *((f"layers[{i}].index", m) for i, (_, m) in enumerate(stack)),
            ("outside_index", self.outside_index),
        ]:
            if not 1 <= index < np.inf:
                raise ValueError(f"{name}: must be at least 1")

    @property
    def outer_distance_m(self) -> float:
        """From the entrance pupil to the last face, along the normal."""
        return self.distance_m + sum(thickness for thickness, _ in self.layers)

    def project(self, camera: Camera, points_m: ArrayLike) -> Array:
        """Points (N, 3) of the outside medium, camera frame -> pixels (N, 2).

        NaN where a point cannot be seen: before the last face, behind the camera, beyond the lens's fold or not finite.
        """
        points = as_rows(points_m, 3)
        pixels = np.empty((len(points), 2))
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            for part in chunks(len(points)):
                across, s, _ = self._slopes(points[part])
                x, y = self._air_direction(across, s)
                pixels[part, 0], pixels[part, 1] = camera.image(x, y)
        return pixels

    def project_with_jacobian(self, camera: Camera, points_m: ArrayLike) -> tuple[Array, Array]:
        """As ``project``, with d(pixel)/d(point) (N, 2, 3), px/m, by the implicit function theorem."""
        points = as_rows(points_m, 3)
        pixels, jacobian = np.empty((len(points), 2)), np.empty((len(points), 2, 3))
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            for part in chunks(len(points)):
                pixels[part], jacobian[part] = self._project_with_jacobian(camera, points[part])
        return pixels, jacobian

    def rays(self, camera: Camera, pixels_px: ArrayLike) -> tuple[Array, Array]:
        """Pixels (N, 2) -> where their rays leave the last face (N, 3), m, and unit directions outside (N, 3).

        Both in the camera's frame; NaN where the pixel does not look through the port.
        """
        xy = camera.normalise(pixels_px)
        xy[~np.isfinite(xy).all(axis=1)] = np.nan
        sight = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)
        forward = sight @ self.normal
        forward[~(forward > 0)] = np.nan
        across = sight / forward[:, None] - self.normal
        q2 = np.einsum("ij,ij->i", across, across)
        shift = np.full(len(xy), self.distance_m)
        for thickness, index in self.layers:
            shift += thickness / np.sqrt(index**2 + (index**2 - 1) * q2)
        outside = across / np.sqrt(self.outside_index**2 + (self.outside_index**2 - 1) * q2)[:, None] + self.normal
        origins = self.normal * self.outer_distance_m + across * shift[:, None]
        return origins, outside / np.linalg.norm(outside, axis=1, keepdims=True)

    def seen_from(self, T_other_left: Pose) -> LayeredPort:
        """The same port in another camera's frame. ValueError if that camera's pupil is not on the inside."""
        normal = T_other_left.rotate(self.normal)
        distance_m = self.distance_m + float(normal @ T_other_left.t_m)
        return LayeredPort(normal, distance_m, self.layers, self.outside_index)

    def _stack(self, outside_m: Array) -> list[tuple[Array | float, float]]:
        """Every medium after the inner air, as (length along the normal, index squared)."""
        inner = [(thickness, index**2) for thickness, index in self.layers]
        return [*inner, (outside_m, self.outside_index**2)]

    def _slopes(self, points_m: Array) -> tuple[Array, Array, Array]:
        """The part of the points across the normal (3, N), the slope s per metre (N,), the distance outside (N,)."""
        p = np.ascontiguousarray(points_m.T)
        along = self.normal @ p
        across = p - self.normal[:, None] * along
        outside_m = along - self.outer_distance_m
        outside_m[~(outside_m >= 0)] = np.nan
        r2 = np.einsum("ij,ij->j", across, across)
        stack = self._stack(outside_m)
        s = self._start(stack, r2)
        for _ in range(_STEPS):
            u = s * s * r2
            length: Array | float = self.distance_m
            slope: Array | float = self.distance_m
            for thickness, m2 in stack:
                w2 = 1.0 / (m2 + (m2 - 1.0) * u)
                tw = thickness * np.sqrt(w2)
                length = length + tw
                slope = slope + m2 * (tw * w2)
            step = (1.0 - s * length) / slope
            s = s + step
            if not np.any(abs(step) > _SETTLED * s):
                break
        return across, s, outside_m

    def _start(self, stack: list[tuple[Array | float, float]], r2: Array) -> Array:
        """The slope s to the second order in r^2, by the series of w_i; within half a percent at 35 degrees."""
        first: Array | float = self.distance_m
        second: Array | float = 0.0
        third: Array | float = 0.0
        for thickness, m2 in stack:
            straight, bend = thickness / math.sqrt(m2), (m2 - 1) / m2
            first = first + straight
            second = second + (0.5 * bend) * straight
            third = third + (0.375 * bend**2) * straight
        s = 1.0 / first
        b, u = second * s, s * s * r2
        rise = u * (b + (3 * b * b - third * s) * u)
        return np.asarray(s * (1 + np.minimum(rise, _MOST_RISE)))

    def _air_direction(self, across: Array, s: Array) -> tuple[Array, Array]:
        """Normalised coordinates x, y of the ray normal + s * across; NaN behind the camera."""
        z = self.normal[2] + s * across[2]
        z[~(z > 0)] = np.nan
        inverse = 1.0 / z
        return (self.normal[0] + s * across[0]) * inverse, (self.normal[1] + s * across[1]) * inverse

    def _project_with_jacobian(self, camera: Camera, points_m: Array) -> tuple[Array, Array]:
        across, s, outside_m = self._slopes(points_m)
        ds = self._slope_gradient(across, s, outside_m)
        n = self.normal[:, None]
        x, y = self._air_direction(across, s)
        z = self.normal[2] + s * across[2]
        # ray v = n + s * across, across = (I - n n^T) p: dv_i/dp_j = s (I - n n^T)_ij + across_i ds_j
        dv = s * (np.eye(3) - n @ n.T)[:, :, None] + across[:, None, :] * ds[None, :, :]
        dx, dy = (dv[0] - x * dv[2]) / z, (dv[1] - y * dv[2]) / z
        u, v, by_xy = camera.image_with_jacobian(x, y)
        jacobian = by_xy[:, :, 0, None] * dx.T[:, None, :] + by_xy[:, :, 1, None] * dy.T[:, None, :]
        return np.stack([u, v], axis=1), jacobian

    def _slope_gradient(self, across: Array, s: Array, outside_m: Array) -> Array:
        """ds/dp (3, N) from g(s, r^2, outside) = 0."""
        u = s * s * np.einsum("ij,ij->j", across, across)
        by_s, by_r2 = np.full_like(s, self.distance_m), np.zeros_like(s)
        w = np.ones_like(s)
        for thickness, m2 in self._stack(outside_m):
            w = 1.0 / np.sqrt(m2 + (m2 - 1.0) * u)
            by_s += m2 * thickness * w**3
            by_r2 -= 0.5 * (m2 - 1.0) * thickness * w**3
        by_r2 *= s**3
        gradient: Array = -(2 * by_r2 * across + (s * w) * self.normal[:, None]) / by_s
        return gradient
