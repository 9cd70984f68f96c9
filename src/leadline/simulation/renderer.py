"""One camera's picture: rays through the port (made once), surfaces, light, water, snow, spot, lens and sensor."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from leadline.geometry import Pose
from leadline.rig import Rig, Side
from leadline.samples import Array, Image
from leadline.simulation.lens import smear
from leadline.simulation.optics import Float, develop, f32, spread
from leadline.simulation.particles import Snow, project_side, splat
from leadline.simulation.scenario import CameraPart
from leadline.simulation.scene import LAMPS_LEFT_M, Patch, Scene
from leadline.simulation.shapes import dot
from leadline.simulation.spot import Beamed, beam_glow, spot_light

Window = tuple[slice, slice]
Box = tuple[int, int, int, int]
_COARSE = 8  # the target is looked for on every 8th ray first


@dataclass(frozen=True, slots=True)
class View:
    """The moment of an exposure: where the scene is, how far it moves over the sensor meanwhile, the beam."""

    t_s: float
    T_left_scene: Pose
    distance_m: float  # of the target's surface: for exposure, focus
    target_motion_px: Array
    backdrop_motion_px: Array
    beam: Beamed | None


class Eye:
    """A camera of the rig, in the water."""

    def __init__(self, rig: Rig, side: Side, part: CameraPart) -> None:
        self.rig, self.side, self._part = rig, side, part
        camera = rig.left if side == "left" else rig.right
        self.width, self.height = camera.width, camera.height
        x, y = np.meshgrid(np.arange(self.width, dtype=float), np.arange(self.height, dtype=float))
        origins, directions = rig.rays(np.stack([x.ravel(), y.ravel()], 1), side)
        directions[~np.isfinite(directions).all(1)] = [0.0, 0.0, -1.0]  # such a pixel looks at nothing
        self._origins = self._as_image(np.nan_to_num(origins))
        self._directions = self._as_image(directions)
        self.pixel_rad = self._pixel_angles(directions.reshape(self.height, self.width, 3))
        self.focal_px = float(1 / self.pixel_rad[self.height // 2, self.width // 2])
        radius2 = ((x - x.mean()) ** 2 + (y - y.mean()) ** 2) / (x.mean() ** 2 + y.mean() ** 2)
        self._vignette = spread(f32(1 - part.vignetting * radius2))
        forward = np.maximum(self._directions[2], 0)
        self._cone = forward**4
        glow = f32(1 - 0.45 * self._directions[1] + 0.25 * forward**8)
        self._glow = spread(glow / glow[self.height // 2, self.width // 2])

    def _as_image(self, rows: Array) -> Float:
        return np.ascontiguousarray(rows.T.reshape(3, self.height, self.width), dtype=np.float32)

    @staticmethod
    def _pixel_angles(directions: Array) -> Float:
        across = np.linalg.norm(np.gradient(directions, axis=1), axis=2)
        down = np.linalg.norm(np.gradient(directions, axis=0), axis=2)
        return f32(np.maximum(0.5 * (across + down), 1e-6))

    def rays_in(self, T_left_scene: Pose, window: Window = (slice(None), slice(None))) -> tuple[Float, Float]:
        """Origins and directions (3, h, w) of a part of the picture in the scene's frame."""
        inverse = T_left_scene.inverse()
        R, t = inverse.R.astype(np.float32), inverse.t_m.astype(np.float32)
        origins, directions = self._origins[(slice(None), *window)], self._directions[(slice(None), *window)]
        # Row by row: a matrix product of this shape would wake threads that the other camera needs.
        moved = np.stack([dot(row, origins) + shift for row, shift in zip(R, t, strict=True)])
        return moved, np.stack([dot(row, directions) for row in R])

    def target_window(self, scene: Scene, T_left_scene: Pose) -> Window | None:
        """The part of the picture in which the target stands, a little too large; None where it is not in view."""
        rows, columns = slice(None, None, _COARSE), slice(None, None, _COARSE)
        origins, directions = self.rays_in(T_left_scene, (rows, columns))
        cover = scene.shape.coverage(origins, directions, self.pixel_rad[rows, columns] * np.float32(3 * _COARSE))
        y, x = np.nonzero(cover > 0)
        if len(x) == 0:
            return None
        low = np.maximum(np.array([y.min(), x.min()]) - 1, 0) * _COARSE
        high = (np.array([y.max(), x.max()]) + 2) * _COARSE
        return slice(int(low[0]), min(int(high[0]), self.height)), slice(int(low[1]), min(int(high[1]), self.width))

    def render(self, scene: Scene, view: View, snow: Snow, rng: np.random.Generator) -> tuple[Image, Box | None]:
        """The picture (h, w, 3), and the box x0, y0, x1, y1 (px, ends not included) of the target's pixels."""
        lamps = view.T_left_scene.inverse().apply(LAMPS_LEFT_M)
        window = self.target_window(scene, view.T_left_scene)
        light, distance = self._behind(scene, view, lamps, window)
        box = None
        if window is not None:
            box = self._before(scene, view, lamps, window, light, distance)
        self._scatter_forward(scene, light, distance)
        light += self._veil(scene, distance)
        self._add_snow(scene, view, snow, light, distance)
        gain = scene.gain(view.distance_m)
        light *= self._vignette
        light *= np.float32(gain)
        return develop(light, rng, self._part.shot_noise * gain, self._part.read_noise * max(gain, 1.0)), box

    def _behind(self, scene: Scene, view: View, lamps: Array, window: Window | None) -> tuple[Float, Float]:
        """Light (h, w, 3) of the backdrop as it arrives, and distance (h, w)."""
        size = (self.height, self.width)
        covered = window == (slice(0, self.height), slice(0, self.width)) and scene.shape.reach_m == 0
        if scene.backdrop is None or covered:
            return np.zeros((*size, 3), np.float32), np.full(size, 60.0, np.float32)
        patch = scene.backdrop.patch(*self.rays_in(view.T_left_scene), self.pixel_rad)
        everything = (slice(0, self.height), slice(0, self.width))
        light = self._lit(scene, view, lamps, patch, everything, on_target=False)
        distance = float(np.median(patch.distance_m[::_COARSE, ::_COARSE]))
        return smear(light, self._blur_px(scene, distance), view.backdrop_motion_px), patch.distance_m

    def _before(
        self, scene: Scene, view: View, lamps: Array, window: Window, light: Float, distance: Float
    ) -> Box | None:
        """Lay the target over ``light`` and ``distance`` in place; the box of its pixels."""
        origins, directions = self.rays_in(view.T_left_scene, window)
        patch = scene.target_patch(origins, directions, self.pixel_rad[window])
        direct = self._lit(scene, view, lamps, patch, window, on_target=True)
        blur = self._blur_px(scene, view.distance_m), view.target_motion_px
        alpha = smear(patch.coverage, *blur)
        direct *= spread(patch.coverage)
        light[window] *= spread(1 - alpha)
        light[window] += smear(direct, *blur)
        distance[window] += (patch.distance_m - distance[window]) * alpha
        return _box(patch.coverage > 0.5, window)

    def _lit(self, scene: Scene, view: View, lamps: Array, patch: Patch, window: Window, on_target: bool) -> Float:
        """Light (h, w, 3) from a patch after its way to the camera, with the laser's spot where it lies there."""
        day, lamp = scene.illuminate(patch, lamps, view.t_s, self._cone[window])
        through = scene.optics.transmission(patch.distance_m)
        light: Float = through * spread(lamp)
        light += spread(day)
        light *= patch.reflectance
        light *= through
        if view.beam is not None and view.beam.on_target == on_target:
            self._add_spot(scene, view, view.beam, light, window)
        return light

    def _add_spot(self, scene: Scene, view: View, beam: Beamed, light: Float, window: Window) -> None:
        centre = project_side(self.rig, self.side, beam.point_left_m[None])[0]
        if not np.isfinite(centre).all():
            return
        reach = beam.reach_px(self.focal_px, float(np.linalg.norm(beam.point_left_m)))
        top, left = window[0].start, window[1].start
        low = np.maximum(np.floor(centre[::-1] - reach), [top, left]).astype(int)
        high = np.minimum(np.ceil(centre[::-1] + reach) + 1, [window[0].stop, window[1].stop]).astype(int)
        if (high <= low).any():
            return
        part = (slice(int(low[0]), int(high[0])), slice(int(low[1]), int(high[1])))
        spot = spot_light(scene, beam, *self.rays_in(view.T_left_scene, part), self.pixel_rad[part])
        light[part[0].start - top : part[0].stop - top, part[1].start - left : part[1].stop - left] += spot

    def _blur_px(self, scene: Scene, distance_m: float) -> float:
        """Standard deviation of the lens's and the water's blur at a distance."""
        part = self._part
        disc_px = part.aperture_m * self.focal_px * abs(1 / max(distance_m, 0.05) - 1 / part.focus_m)
        water_px = 1.2e-3 * self.focal_px * scene.optics.forward * min(distance_m, 5.0)
        return float(np.sqrt(0.35**2 + (disc_px / 4) ** 2 + water_px**2))

    def _scatter_forward(self, scene: Scene, light: Float, distance: Float) -> None:
        """A part of the light goes astray on its way, the more the longer: a wide halo, in place."""
        if scene.optics.forward == 0:
            return
        small = cv2.resize(light, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
        halo = cv2.GaussianBlur(small, (0, 0), 0.004 * self.width)
        halo = f32(cv2.resize(halo, (self.width, self.height), interpolation=cv2.INTER_LINEAR))
        astray = 1 - np.exp(np.float32(-scene.optics.forward) * distance)
        halo -= light
        halo *= spread(astray)
        light += halo

    def _veil(self, scene: Scene, distance: Float) -> Float:
        veil = scene.veil_light(distance)
        veil *= self._glow
        return veil

    def _add_snow(self, scene: Scene, view: View, snow: Snow, light: Float, distance: Float) -> None:
        places, radius = snow.seen(view.t_s, view.T_left_scene)
        share, away = np.full(len(places), 0.3), np.linalg.norm(places, axis=1)
        pixels = project_side(self.rig, self.side, places)
        size_px = radius / away * self.focal_px
        sigma = np.sqrt(size_px**2 * 0.5 + 0.45**2 + (self._defocus_px(away) / 4) ** 2)
        share = share * np.minimum(size_px**2 / (2 * sigma**2), 1)
        through = scene.optics.transmission(f32(away))
        lamp = np.float32(1) / (f32(away) ** 2 + np.float32(0.05))
        shine = f32(share)[:, None] * through * (np.float32(0.7) + np.float32(0.4) * lamp[:, None] * through)
        shine *= np.float32(scene.veil_level)
        if view.beam is not None:
            glow = beam_glow(scene.optics, view.beam, self.focal_px)
            pixels = np.concatenate([pixels, project_side(self.rig, self.side, glow.places_m)])
            sigma, away = np.concatenate([sigma, glow.sigma_px]), np.concatenate([away, glow.distance_m])
            shine = np.concatenate([shine, glow.shine])
        x, y = np.nan_to_num(pixels, nan=-1e4).T
        inside = (x > -20) & (x < self.width + 20) & (y > -20) & (y < self.height + 20)
        pixels, sigma, away, shine = pixels[inside], sigma[inside], away[inside], shine[inside]
        column = np.clip(np.round(pixels[:, 0]).astype(int), 0, self.width - 1)
        row = np.clip(np.round(pixels[:, 1]).astype(int), 0, self.height - 1)
        free = away < distance[row, column] + 0.005
        splat(light, pixels[free], sigma[free], shine[free])

    def _defocus_px(self, distance_m: Array) -> Array:
        return np.asarray(self._part.aperture_m * self.focal_px * np.abs(1 / distance_m - 1 / self._part.focus_m))


def _box(mask: np.ndarray[tuple[int, ...], np.dtype[np.bool_]], window: Window) -> Box | None:
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if len(rows) == 0:
        return None
    top, left = window[0].start, window[1].start
    return left + int(columns[0]), top + int(rows[0]), left + int(columns[-1]) + 1, top + int(rows[-1]) + 1
