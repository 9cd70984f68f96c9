"""The laser's light: its spot on what it meets, and the faint line of its beam in the water."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from leadline.samples import Array
from leadline.simulation.optics import Float, WaterOptics, f32
from leadline.simulation.scene import Scene
from leadline.simulation.shapes import column, dot

_COLOUR_BGR = f32([0.18, 1.0, 0.25])  # 532 nm behind a Bayer filter
_SUB = 4  # samples a pixel, each way


@dataclass(frozen=True, slots=True)
class Beamed:
    """The beam at one moment. Directions and places in the scene's frame, save where the name says otherwise."""

    origin_m: Array
    direction: Array
    length_m: float
    point_left_m: Array
    origin_left_m: Array
    normal: Array  # of the surface that it meets
    on_target: bool
    radius_m: float  # where the light falls to 1/e^2
    power: float

    def reach_px(self, focal_px: float, distance_m: float) -> float:
        """Half the side of a window that holds the spot, however slanted the surface."""
        slant = max(0.25, abs(float(self.normal @ self.direction)))
        return min(2.2 * self.radius_m / slant / distance_m * focal_px + 3, 200.0)


def spot_light(scene: Scene, beam: Beamed, origins: Float, directions: Float, pixel_rad: Float) -> Float:
    """(h, w, 3) the spot's light as it arrives at the camera over a window of rays, each pixel the mean of 16 rays."""
    fine_origins, fine_directions = _finer(origins), _finer(directions)
    angle = f32(cv2.resize(pixel_rad, None, fx=_SUB, fy=_SUB)) / np.float32(_SUB)
    if beam.on_target:
        patch = scene.target_patch(fine_origins, fine_directions, angle)
    else:
        assert scene.backdrop is not None
        patch = scene.backdrop.patch(fine_origins, fine_directions, angle)
    way = patch.points_m - column(beam.origin_m)
    along = dot(beam.direction, way)
    across2 = dot(way, way) - along * along
    profile = np.exp(np.float32(-2 / beam.radius_m**2) * np.maximum(across2, 0))
    facing = np.maximum(-dot(beam.direction, patch.normal), 0)
    arriving: Float = np.float32(beam.power * np.exp(-scene.optics.c[1] * beam.length_m)) * profile * facing
    arriving = arriving * patch.reflectance[..., 1] * patch.coverage
    light: Float = arriving[..., None] * _COLOUR_BGR * scene.optics.transmission(patch.distance_m)
    height, width = pixel_rad.shape
    return f32(cv2.resize(light, (width, height), interpolation=cv2.INTER_AREA))


def _finer(rays: Float) -> Float:
    """(3, h, w) to (3, 4 h, 4 w): rays of the pixels' parts (smooth, so linear interpolation does)."""
    return np.stack([f32(cv2.resize(part, None, fx=_SUB, fy=_SUB, interpolation=cv2.INTER_LINEAR)) for part in rays])


@dataclass(frozen=True, slots=True)
class Glow:
    places_m: Array  # (N, 3) left frame
    distance_m: Array
    sigma_px: Array
    shine: Float  # (N, 3)


def beam_glow(optics: WaterOptics, beam: Beamed, focal_px: float) -> Glow:
    """Blobs along the beam: backscatter of the laser's own light."""
    step = 0.012
    lengths = np.arange(0.06, min(beam.length_m, 3.0), step)
    direction_left = (beam.point_left_m - beam.origin_left_m) / beam.length_m
    places = beam.origin_left_m + lengths[:, None] * direction_left
    distance = np.linalg.norm(places, axis=1)
    sigma = np.sqrt((beam.radius_m / 2 / distance * focal_px) ** 2 + 0.6**2)
    level = 0.012 * beam.power * optics.B[1] * optics.k[1] * np.exp(-optics.c[1] * lengths)
    return Glow(places, distance, sigma, f32(level)[:, None] * _COLOUR_BGR * optics.transmission(f32(distance)))
