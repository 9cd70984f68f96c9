"""Shapes in the scene's frame: exact hits and nearest points (float64), and whole images of rays (float32).

An image of rays is (3, h, w) origins and (3, h, w) unit directions. ``trace`` gives for each the distance, how much of
the pixel is covered (anti-aliased at the limb; ``pixel_rad`` is a pixel's angle), the normal and the chart's (u, v) in
metres on the surface.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from leadline.samples import Array
from leadline.simulation.motion import rotation
from leadline.simulation.optics import Float
from leadline.simulation.scenario import TargetPart


@dataclass(frozen=True, slots=True)
class Trace:
    distance_m: Float  # (h, w)
    coverage: Float  # (h, w) 0..1
    normal: Float  # (3, h, w)
    u_m: Float
    v_m: Float


class Shape(Protocol):
    @property
    def reach_m(self) -> float:
        """From the scene's origin to the front."""
        ...

    def coverage(self, origins: Float, directions: Float, pixel_rad: Float) -> Float:
        """(h, w) how much of each pixel is covered."""
        ...

    def trace(self, origins: Float, directions: Float, pixel_rad: Float) -> Trace: ...

    def hit_m(self, origin_m: Array, direction: Array) -> float | None:
        """Length of a beam to the surface; None where it passes by."""
        ...

    def normal_at(self, point_m: Array) -> Array:
        """(3,) unit, outwards."""
        ...

    def nearest_m(self, eye_m: Array) -> Array:
        """(3,) the surface's nearest point to a place outside."""
        ...

    def position_m(self, eye_m: Array) -> Array:
        """(3,) what is called the target's position, seen from a place (a ball's centre, a plane's foot ...)."""
        ...


def make_shape(target: TargetPart, rng: np.random.Generator) -> Shape:
    radius = target.diameter_m / 2
    tilt = rotation(np.deg2rad([target.tilt_deg[0], target.tilt_deg[1], 0.0]))
    match target.shape:
        case "sphere":
            return Ball(radius)
        case "plane":
            return Wall(tilt @ [0.0, 0.0, -1.0], tilt @ [1.0, 0.0, 0.0])
        case "cylinder":
            return Pile(radius, tilt @ [0.0, 1.0, 0.0])
    from leadline.simulation.lump import Lump  # noqa: PLC0415  it is built on this module

    return Lump(radius, target.bumps, rng)


def dot(a: Array | Float, b: Float) -> Float:
    """Sum over the first axis of (3,) or (3, h, w) with (3, h, w)."""
    x, y, z = (np.float32(v) if np.ndim(v) == 0 else v for v in a)
    result: Float = x * b[0] + y * b[1] + z * b[2]
    return result


def column(vector: Array) -> Float:
    """(3,) as (3, 1, 1) float32."""
    shaped: Float = vector.astype(np.float32).reshape(3, 1, 1)
    return shaped


def edge(margin_m: Float, distance_m: Float, pixel_rad: Float) -> Float:
    """Coverage of a pixel whose ray goes ``margin_m`` inside the limb at a distance."""
    cover: Float = np.clip(margin_m / (pixel_rad * np.maximum(distance_m, np.float32(1e-3))) + np.float32(0.5), 0, 1)
    return cover


def front_chart(normal: Float, radius_m: float) -> tuple[Float, Float]:
    """Equal-area chart of the sphere of directions about -z, the side that the camera sees."""
    stretch = np.float32(radius_m) * np.sqrt(np.float32(2) / np.maximum(np.float32(1) - normal[2], np.float32(0.02)))
    return normal[0] * stretch, normal[1] * stretch


class Ball:
    """A sphere at the origin; its position is its centre."""

    def __init__(self, radius_m: float) -> None:
        self.radius_m = radius_m

    @property
    def reach_m(self) -> float:
        return self.radius_m

    def _limb(self, origins: Float, directions: Float) -> tuple[Float, Float]:
        """Distance to the point of closest approach, and that point's distance from the centre."""
        along: Float = -dot(origins, directions)
        closest = origins + directions * along
        return along, np.sqrt(dot(closest, closest))

    def coverage(self, origins: Float, directions: Float, pixel_rad: Float) -> Float:
        along, miss = self._limb(origins, directions)
        return np.where(along > 0, edge(np.float32(self.radius_m) - miss, along, pixel_rad), np.float32(0))

    def trace(self, origins: Float, directions: Float, pixel_rad: Float) -> Trace:
        along, miss = self._limb(origins, directions)
        cover = np.where(along > 0, edge(np.float32(self.radius_m) - miss, along, pixel_rad), np.float32(0))
        radius = np.float32(self.radius_m)
        distance: Float = along - np.sqrt(np.maximum((radius - miss) * (radius + miss), 0))
        normal = (origins + directions * distance) / np.maximum(miss, radius)
        return Trace(distance, cover, normal, *front_chart(normal, self.radius_m))

    def hit_m(self, origin_m: Array, direction: Array) -> float | None:
        along = -float(origin_m @ direction)
        inside = self.radius_m**2 - float(origin_m @ origin_m) + along**2
        return None if inside <= 0 or along <= 0 else along - float(np.sqrt(inside))

    def normal_at(self, point_m: Array) -> Array:
        return np.asarray(point_m / np.linalg.norm(point_m))

    def nearest_m(self, eye_m: Array) -> Array:
        return np.asarray(eye_m * (self.radius_m / np.linalg.norm(eye_m)))

    def position_m(self, eye_m: Array) -> Array:
        return np.zeros(3)


class Wall:
    """An endless plane through the origin; its position is the foot of the perpendicular."""

    reach_m = 0.0

    def __init__(self, normal: Array, right: Array) -> None:
        self.normal, self.right = normal, right
        self.down = np.cross(right, normal)

    def coverage(self, origins: Float, directions: Float, pixel_rad: Float) -> Float:
        return (dot(self.normal, directions) < 0).astype(np.float32)

    def trace(self, origins: Float, directions: Float, pixel_rad: Float) -> Trace:
        facing = dot(self.normal, directions)
        distance: Float = -dot(self.normal, origins) / np.minimum(facing, np.float32(-1e-4))
        point = origins + directions * distance
        normal = np.broadcast_to(column(self.normal), point.shape)
        cover = (facing < 0).astype(np.float32)
        return Trace(distance, cover, normal, dot(self.right, point), dot(self.down, point))

    def hit_m(self, origin_m: Array, direction: Array) -> float | None:
        facing, height = float(self.normal @ direction), float(self.normal @ origin_m)
        return None if facing >= -1e-6 or height <= 0 else -height / facing

    def normal_at(self, point_m: Array) -> Array:
        return self.normal

    def nearest_m(self, eye_m: Array) -> Array:
        return np.asarray(eye_m - (self.normal @ eye_m) * self.normal)

    def position_m(self, eye_m: Array) -> Array:
        return self.nearest_m(eye_m)


class Pile:
    """An endless cylinder about an axis through the origin; its position is the axis point nearest the camera."""

    def __init__(self, radius_m: float, axis: Array) -> None:
        self.radius_m, self.axis = radius_m, axis
        front = np.array([0.0, 0.0, -1.0])
        self.front = front - (front @ axis) * axis
        self.front /= np.linalg.norm(self.front)
        self.side = np.cross(self.front, axis)

    @property
    def reach_m(self) -> float:
        return self.radius_m

    def _across(self, vectors: Float) -> Float:
        """The part perpendicular to the axis."""
        across: Float = vectors - column(self.axis) * dot(self.axis, vectors)
        return across

    def _limb(self, origins: Float, directions: Float) -> tuple[Float, Float, Float, Float]:
        d, o = self._across(directions), self._across(origins)
        steep = dot(d, d)
        along = -dot(o, d) / np.maximum(steep, np.float32(1e-6))
        closest = o + d * along
        return along, np.sqrt(dot(closest, closest)), np.sqrt(steep), o

    def coverage(self, origins: Float, directions: Float, pixel_rad: Float) -> Float:
        along, miss, _, _ = self._limb(origins, directions)
        return np.where(along > 0, edge(np.float32(self.radius_m) - miss, along, pixel_rad), np.float32(0))

    def trace(self, origins: Float, directions: Float, pixel_rad: Float) -> Trace:
        along, miss, steep, _ = self._limb(origins, directions)
        radius = np.float32(self.radius_m)
        cover = np.where(along > 0, edge(radius - miss, along, pixel_rad), np.float32(0))
        distance: Float = along - np.sqrt(np.maximum((radius - miss) * (radius + miss), 0)) / steep
        point = origins + directions * distance
        normal = self._across(point) / np.maximum(miss, radius)
        u = radius * np.arctan2(dot(self.side, normal), dot(self.front, normal))
        return Trace(distance, cover, normal, u, dot(self.axis, point))

    def hit_m(self, origin_m: Array, direction: Array) -> float | None:
        d = direction - (direction @ self.axis) * self.axis
        o = origin_m - (origin_m @ self.axis) * self.axis
        a, b = float(d @ d), -float(o @ d)
        inside = b**2 - a * (float(o @ o) - self.radius_m**2)
        return None if inside <= 0 or b <= 0 else (b - float(np.sqrt(inside))) / a

    def normal_at(self, point_m: Array) -> Array:
        across = point_m - (point_m @ self.axis) * self.axis
        return np.asarray(across / np.linalg.norm(across))

    def nearest_m(self, eye_m: Array) -> Array:
        return self.position_m(eye_m) + self.radius_m * self.normal_at(eye_m)

    def position_m(self, eye_m: Array) -> Array:
        return np.asarray((eye_m @ self.axis) * self.axis)
