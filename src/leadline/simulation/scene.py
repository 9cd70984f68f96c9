"""What there is to see: a target before a backdrop, daylight, lamps and caustics, in water."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from leadline.samples import Array
from leadline.simulation import textures
from leadline.simulation.materials import Atlas, Material, backdrop_material, target_material
from leadline.simulation.optics import Float
from leadline.simulation.scenario import BackdropPart, Scenario
from leadline.simulation.shapes import dot, make_shape

LAMPS_LEFT_M = np.array([[-0.20, -0.06, 0.0], [0.26, -0.06, 0.0]])  # beside the two cameras
_FAR_M = 60.0


@dataclass(frozen=True, slots=True)
class Patch:
    """A part of the picture, without the water: what surface each ray meets."""

    reflectance: Float  # (h, w, 3)
    points_m: Float  # (3, h, w), scene
    normal: Float  # (3, h, w)
    distance_m: Float  # (h, w)
    coverage: Float  # (h, w)


class Scene:
    def __init__(self, scenario: Scenario, rng: np.random.Generator, texels: int = 2048) -> None:
        self.optics = scenario.optics
        self.shape = make_shape(scenario.target, rng)
        self.skin = target_material(scenario.target, rng, texels)
        self.backdrop = None if scenario.backdrop.kind == "open" else Backdrop(scenario.backdrop, rng)
        self._light = scenario.light
        self._caustics = [Atlas(textures.caustic(rng, 256), period) for period in (1.3, 1.7)]

    def target_patch(self, origins: Float, directions: Float, pixel_rad: Float) -> Patch:
        trace = self.shape.trace(origins, directions, pixel_rad)
        # A slanted surface is filtered for half its longer footprint: between blur and glitter.
        facing = np.maximum(-dot(trace.normal, directions), np.float32(0.15))
        footprint = trace.distance_m * pixel_rad / np.sqrt(facing)
        reflectance = self.skin.reflectance(trace.u_m, trace.v_m, footprint)
        points = origins + directions * trace.distance_m
        return Patch(reflectance, points, trace.normal, trace.distance_m, trace.coverage)

    def illuminate(self, patch: Patch, lamps_scene_m: Array, t_s: float, cone: Float) -> tuple[Float, Float]:
        """Daylight (h, w) and lamplight (h, w) before its way through the water, on a patch."""
        light = self._light
        up = -patch.normal[1]
        day = np.float32(light.ambient) * (np.float32(0.6) + np.float32(0.4) * up)
        if light.caustics > 0 and light.ambient > 0:
            strength = np.float32(light.caustics) * np.clip(np.float32(0.55) + np.float32(0.5) * up, 0, 1)
            day *= np.float32(1) + strength * (self._caustic(patch, t_s) - np.float32(1))
        lamp = np.zeros_like(day)
        if light.lamps > 0:
            for place in lamps_scene_m:
                way = place.astype(np.float32).reshape(3, 1, 1) - patch.points_m
                squared = dot(way, way)
                facing = np.maximum(dot(way, patch.normal), 0) / np.sqrt(squared)
                lamp += facing / (squared + np.float32(0.03))
            lamp *= np.float32(0.5 * light.lamps) * cone
        return day, lamp

    def _caustic(self, patch: Patch, t_s: float) -> Float:
        """Two patterns that drift apart; their darker one, so that lines flicker. Light falls from above, aslant."""
        x, y, z = patch.points_m
        u, v = x + np.float32(0.35) * y, z - np.float32(0.45) * y
        blur = 0.006
        a = self._caustics[0].sample(u + np.float32(0.09 * t_s), v + np.float32(0.05 * t_s), blur)
        b = self._caustics[1].sample(u - np.float32(0.06 * t_s), v + np.float32(0.08 * t_s), blur)
        darker: Float = np.minimum(a, b) * np.float32(1.35)
        return darker

    def gain(self, distance_m: float) -> float:
        """Automatic exposure for something at a distance."""
        light = self._light
        t = float(self.optics.transmission(distance_m)[1])
        direct = 0.35 * (0.6 * light.ambient + light.lamps / (distance_m**2 + 0.05) * t) * t
        return float(np.clip(light.exposure / (direct + float(self.veil_light(distance_m)[1])), 0.05, 8.0))

    def veil_light(self, distance_m: Float | float) -> Float:
        """Backscatter of daylight and lamps over a distance, (..., 3)."""
        veil: Float = self.optics.veil(distance_m) * np.float32(self.veil_level)
        return veil

    @property
    def veil_level(self) -> float:
        return 0.8 * self._light.ambient + 0.25 * self._light.lamps

    def beam_hit(self, origin_m: Array, direction: Array) -> tuple[float, bool] | None:
        """Length of the laser's beam to what it meets first, and whether that is the target."""
        length = self.shape.hit_m(origin_m, direction)
        behind = None if self.backdrop is None else self.backdrop.hit_m(origin_m, direction)
        if length is not None and (behind is None or length <= behind):
            return length, True
        return None if behind is None else (behind, False)


class Backdrop:
    """A floor, and for a pool a wall behind the target."""

    def __init__(self, part: BackdropPart, rng: np.random.Generator) -> None:
        self._wall_m = part.wall_m if part.kind == "pool" else None
        self._floor_m = part.floor_m
        self._material: Material = backdrop_material(part, rng)

    def patch(self, origins: Float, directions: Float, pixel_rad: Float) -> Patch:
        down = np.maximum(directions[1], np.float32(1e-4))
        distance = (np.float32(self._floor_m) - origins[1]) / down
        on_floor = np.ones(distance.shape, bool)
        if self._wall_m is not None:
            ahead = np.maximum(directions[2], np.float32(1e-4))
            to_wall = (np.float32(self._wall_m) - origins[2]) / ahead
            on_floor = distance < to_wall
            distance = np.where(on_floor, distance, to_wall)
        distance = np.clip(distance, 0, np.float32(_FAR_M))
        points = origins + directions * distance
        facing = np.where(on_floor, directions[1], directions[2])
        footprint = distance * pixel_rad / np.sqrt(np.maximum(facing, np.float32(0.02)))
        v = np.where(on_floor, points[2], points[1])
        reflectance = self._material.reflectance(points[0], v, footprint)
        normal = np.zeros_like(points)
        normal[1] = np.where(on_floor, np.float32(-1), np.float32(0))
        normal[2] = np.where(on_floor, np.float32(0), np.float32(-1))
        return Patch(reflectance, points, normal, distance, np.ones_like(distance))

    def hit_m(self, origin_m: Array, direction: Array) -> float | None:
        lengths = [(self._floor_m - origin_m[1]) / direction[1]] if direction[1] > 1e-6 else []
        if self._wall_m is not None and direction[2] > 1e-6:
            lengths.append((self._wall_m - origin_m[2]) / direction[2])
        return float(min(lengths)) if lengths else None

    def normal_at(self, point_m: Array) -> Array:
        on_wall = self._wall_m is not None and abs(point_m[2] - self._wall_m) < 1e-6
        return np.array([0.0, 0.0, -1.0]) if on_wall else np.array([0.0, -1.0, 0.0])
