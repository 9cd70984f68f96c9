"""An irregular lump: a ball whose radius varies with direction, r(n) = R (1 + sum a_i sin(w_i . n + phase_i))."""

from __future__ import annotations

import numpy as np

from leadline.samples import Array
from leadline.simulation.optics import Float
from leadline.simulation.shapes import Trace, dot, edge, front_chart

_WAVES = 6
_NEWTON_STEPS = 5


class Lump:
    """Star-shaped about the origin; its position is the surface point nearest the camera."""

    def __init__(self, radius_m: float, bumps: float, rng: np.random.Generator) -> None:
        self.radius_m = radius_m
        w = rng.standard_normal((_WAVES, 3))
        self._w = w / np.linalg.norm(w, axis=1, keepdims=True) * rng.uniform(1.5, 6.0, (_WAVES, 1))
        self._phase = rng.uniform(0, 2 * np.pi, _WAVES)
        share = 1 / np.linalg.norm(self._w, axis=1)  # slopes alike at all scales
        self._a = bumps * share / share.sum()
        self._outer_m = radius_m * (1 + bumps)

    @property
    def reach_m(self) -> float:
        return float(self.radius(np.array([0.0, 0.0, -1.0])))

    def radius(self, n: Array) -> Array:
        """r of unit directions (..., 3), m."""
        return np.asarray(self.radius_m * (1 + np.sin(n @ self._w.T + self._phase) @ self._a))

    def _radius_gradient(self, n: Array) -> Array:
        return np.asarray(self.radius_m * ((np.cos(n @ self._w.T + self._phase) * self._a) @ self._w))

    # Whole images

    def _radius_image(self, n: Float) -> Float:
        total = np.ones(n.shape[1:], np.float32)
        for w, a, phase in zip(self._w, self._a, self._phase, strict=True):
            total += np.float32(a) * np.sin(dot(w, n) + np.float32(phase))
        return total * np.float32(self.radius_m)

    def _gradient_image(self, n: Float) -> Float:
        total = np.zeros_like(n)
        for w, a, phase in zip(self._w, self._a, self._phase, strict=True):
            slope = np.float32(a * self.radius_m) * np.cos(dot(w, n) + np.float32(phase))
            for i in range(3):
                total[i] += np.float32(w[i]) * slope
        return total

    def coverage(self, origins: Float, directions: Float, pixel_rad: Float) -> Float:
        along = -dot(origins, directions)
        closest = origins + directions * along
        miss = np.sqrt(dot(closest, closest))
        margin = self._radius_image(closest / np.maximum(miss, np.float32(1e-6))) - miss
        # Where the surface leans over, the ray grazes it before its closest approach: one step towards the limb.
        normal = self._normals(closest)
        shift = np.clip(dot(normal, directions), -0.5, 0.5) * np.float32(self.radius_m)
        moved = closest - directions * shift
        length = np.sqrt(dot(moved, moved))
        margin = np.maximum(margin, self._radius_image(moved / length) - length)
        return np.where(along > 0, edge(margin, along, pixel_rad), np.float32(0))

    def trace(self, origins: Float, directions: Float, pixel_rad: Float) -> Trace:
        cover = self.coverage(origins, directions, pixel_rad)
        along = -dot(origins, directions)
        closest = origins + directions * along
        squared = dot(closest, closest)
        # From the outer ball inwards, each time onto the ball of the radius found there.
        distance = along - np.sqrt(np.maximum(np.float32(self._outer_m**2) - squared, 0))
        for _ in range(_NEWTON_STEPS):
            point = origins + directions * distance
            length = np.sqrt(dot(point, point))
            radial = point / length
            gap = length - self._radius_image(radial)
            normal = self._tilt(radial, length)
            distance = distance - gap / np.minimum(dot(normal, directions), np.float32(-0.15))
        point = origins + directions * np.minimum(distance, along)
        normal = self._normals(point)
        normal /= np.sqrt(dot(normal, normal))
        radial = point / np.sqrt(dot(point, point))
        return Trace(np.minimum(distance, along), cover, normal, *front_chart(radial, self.radius_m))

    def _normals(self, points: Float) -> Float:
        length = np.sqrt(dot(points, points))
        return self._tilt(points / np.maximum(length, np.float32(1e-6)), length)

    def _tilt(self, radial: Float, length: Float) -> Float:
        """Gradient of |p| - r(p / |p|): not of unit length."""
        slope = self._gradient_image(radial)
        across = slope - radial * dot(radial, slope)
        tilted: Float = radial - across / np.maximum(length, np.float32(1e-6))
        return tilted

    # Single rays and points, exact

    def hit_m(self, origin_m: Array, direction: Array) -> float | None:
        along = -float(origin_m @ direction)
        inside = self._outer_m**2 - float(origin_m @ origin_m) + along**2
        if inside <= 0 or along <= 0:
            return None
        half = float(np.sqrt(inside))
        lengths = np.linspace(along - half, along + half, 400)
        below = np.flatnonzero(self._height(origin_m, direction, lengths) < 0)
        if len(below) == 0:
            return None
        low, high = lengths[max(below[0] - 1, 0)], lengths[below[0]]
        for _ in range(50):
            middle = 0.5 * (low + high)
            outside = self._height(origin_m, direction, np.array([middle]))[0] > 0
            low, high = (middle, high) if outside else (low, middle)
        return float(high)

    def _height(self, origin_m: Array, direction: Array, lengths_m: Array) -> Array:
        points = origin_m + lengths_m[:, None] * direction
        length = np.linalg.norm(points, axis=1)
        return np.asarray(length - self.radius(points / length[:, None]))

    def normal_at(self, point_m: Array) -> Array:
        length = float(np.linalg.norm(point_m))
        n = point_m / length
        slope = self._radius_gradient(n)
        tilted = n - (slope - (slope @ n) * n) / length
        return np.asarray(tilted / np.linalg.norm(tilted))

    def nearest_m(self, eye_m: Array) -> Array:
        """The best of a grid of directions, refined on ever finer ones until 1e-9."""
        towards = eye_m / np.linalg.norm(eye_m)
        across = np.linalg.svd(towards[None, :])[2][1:]
        centre, step, reach = np.zeros(2), 0.06, 20
        while step > 1e-9:
            grid = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 2), -1).reshape(-1, 2)
            places = centre + step * grid
            n = towards + places @ across
            n /= np.linalg.norm(n, axis=1, keepdims=True)
            distance = np.linalg.norm(self.radius(n)[:, None] * n - eye_m, axis=1)
            centre = places[int(np.argmin(distance))]
            step, reach = step / 3, 4
        n = towards + centre @ across
        n /= np.linalg.norm(n)
        return np.asarray(self.radius(n) * n)

    def position_m(self, eye_m: Array) -> Array:
        return self.nearest_m(eye_m)
