"""Balls among other solids before a backdrop, in perspective, lit from above and by lamps, with shadows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leadline.simulation.canvas import Box, Canvas
from leadline.simulation.optics import Float, WaterOptics
from leadline.simulation.skins import painted
from leadline.simulation.solids import Placed, Seen, Solid, box, cylinder, random_distractor, random_turn, see, sphere

Area = tuple[slice, slice]
MOST_VISIBLE_M = 2.2  # over the attenuation: beyond, nothing is left of a thing to see
SHADOW_PART = 0.8  # a solid casts the shadow of a ball so much smaller than its reach


@dataclass(frozen=True, slots=True)
class Lights:
    """The sun's direction (3,) towards it; strengths of sun, sky, lamps beside the camera, and gloss."""

    sun: NDArray[np.float32]
    sunny: float
    sky: float
    lamp: float


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole in the picture's middle."""

    focal_px: float
    size: tuple[int, int]  # height, width

    def rays(self, at: Area) -> Float:
        """(3, n) unit rays of the area's pixels, row by row."""
        y, x = np.mgrid[at].astype(np.float32) + np.float32(0.5)
        across = (x.ravel() - np.float32(self.size[1] / 2)) / np.float32(self.focal_px)
        down = (y.ravel() - np.float32(self.size[0] / 2)) / np.float32(self.focal_px)
        ray = np.stack([across, down, np.ones_like(across)])
        unit: Float = ray / np.sqrt((ray * ray).sum(0))
        return unit

    def area(self, placed: Placed) -> Area:
        """The pixels where the solid may be seen."""
        height, width = self.size
        x, y, z = placed.centre_m
        if z < 2 * placed.reach_m:
            return slice(0, height), slice(0, width)
        middle = np.array([x, y]) / z * self.focal_px + [width / 2, height / 2]
        r = 1.25 * self.focal_px * placed.reach_m / z * np.hypot(1, np.hypot(x, y) / z) + 2
        low = np.clip(np.floor(middle - r), 0, [width, height]).astype(int)
        high = np.clip(np.ceil(middle + r), 0, [width, height]).astype(int)
        return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


@dataclass(frozen=True, slots=True)
class Scene:
    camera: Camera
    lights: Lights
    solids: list[Placed]


def add_solids(rng: np.random.Generator, canvas: Canvas, water: WaterOptics) -> list[Box]:
    """Paint none to eight solids, some of them balls; each ball's box within the picture (all zero: not in it)."""
    size = canvas.distance_m.shape
    camera = Camera(float(size[1] * np.exp(rng.uniform(np.log(0.6), np.log(1.4)))), (size[0], size[1]))
    slant = rng.normal([0, -1, -0.2], 0.5)
    lights = Lights(
        (slant / np.linalg.norm(slant)).astype(np.float32), rng.uniform(0, 0.8), rng.uniform(0.1, 0.7),
        rng.uniform(0.0, 0.8) if rng.random() < 0.7 else 0.0,
    )  # fmt: skip
    balls = int(rng.choice([0, 1, 2, 3, 4], p=[0.17, 0.5, 0.19, 0.09, 0.05]))
    others = int(rng.choice(9, p=[0.12, 0.14, 0.17, 0.17, 0.14, 0.1, 0.08, 0.05, 0.03]))
    far = min(8.0, MOST_VISIBLE_M / min(water.c))
    far_m = np.minimum(far, np.float32(0.9) * canvas.distance_m)
    solids = [_ball(rng, camera, far_m, alone=balls == 1) for _ in range(balls)]
    solids += [_other(rng, camera, far_m) for _ in range(others)]
    scene = Scene(camera, lights, solids)
    _shadow_backdrop(canvas, scene)
    return [_paint(rng, canvas, scene, k, ball=k < balls) for k in range(len(solids))][:balls]


def _ball(rng: np.random.Generator, camera: Camera, far_m: Float, alone: bool) -> Placed:
    """8 px to more than the view."""
    height, width = camera.size
    largest = 1.0 * max(height, width) if alone else 0.35 * min(height, width)
    radius_px = float(np.exp(rng.uniform(np.log(7), np.log(largest))))
    return _somewhere(rng, camera, sphere(), radius_px, far_m)


def _other(rng: np.random.Generator, camera: Camera, far_m: Float) -> Placed:
    radius_px = float(np.exp(rng.uniform(np.log(10), np.log(0.5 * min(camera.size)))))
    if rng.random() < 0.15:  # a pipe or a beam through the picture
        thick = float(rng.uniform(0.02, 0.15))
        long = cylinder(thick, 1.0) if rng.random() < 0.6 else box(np.array([thick, 1.0, thick]))
        return _somewhere(rng, camera, long, 3 * radius_px, far_m)
    return _somewhere(rng, camera, random_distractor(rng), radius_px, far_m)


def _somewhere(rng: np.random.Generator, camera: Camera, solid: Solid, radius_px: float, far_m: Float) -> Placed:
    """Of about that size in the picture, its middle in it or little outside; nearer than ``far_m`` (h, w) there."""
    height, width = camera.size
    reach = np.array([width, height]) + 1.2 * radius_px
    at = rng.uniform(0, 1, 2) * reach - 0.6 * radius_px
    column, row = np.clip(at, 0, [width - 1, height - 1]).astype(int)
    distance = min(float(far_m[row, column]), 0.17 * camera.focal_px / radius_px * rng.uniform(0.6, 1.6) + 0.15)
    radius_m = radius_px / camera.focal_px * distance
    distance = max(distance, 1.15 * radius_m * solid.reach)  # the camera stays outside
    ray = np.array([*((at - np.array([width, height]) / 2) / camera.focal_px), 1.0])
    return Placed(solid, ray / np.linalg.norm(ray) * distance, random_turn(rng), radius_m)


def _paint(rng: np.random.Generator, canvas: Canvas, scene: Scene, number: int, ball: bool) -> Box:
    camera, solids, lights = scene.camera, scene.solids, scene.lights
    placed = solids[number]
    at = camera.area(placed)
    shape = (at[0].stop - at[0].start, at[1].stop - at[1].start)
    if min(shape) <= 0:
        return 0.0, 0.0, 0.0, 0.0
    rays = camera.rays(at)
    seen = see(placed, rays, 1 / camera.focal_px)
    there = seen.alpha > 0
    rays = rays[:, there]
    part = Seen(seen.length_m[there], seen.alpha[there], seen.normal[:, there], seen.point[:, there])
    colour = painted(rng, part.point / np.float32(placed.solid.reach), board=not ball and rng.random() < 0.15)
    shade = _shade(rng, part, rays, [p for p in solids if p is not placed], lights)
    in_front = part.length_m < canvas.distance_m[at].ravel()[there]
    flat = np.flatnonzero(there)[in_front]
    if not len(flat):
        return 0.0, 0.0, 0.0, 0.0
    alpha = part.alpha[in_front]
    for layer, values in (
        (canvas.reflectance, colour[in_front]),
        (canvas.distance_m, part.length_m[in_front]),
        (canvas.shading, shade[in_front]),
    ):
        patch = layer[at].reshape(shape[0] * shape[1], -1)
        patch[flat] += (values.reshape(len(flat), -1) - patch[flat]) * alpha[:, None]
        layer[at] = patch.reshape(layer[at].shape)
    owner = canvas.owner[at].ravel()
    owner[flat[alpha > 0.5]] = number if ball else -1
    canvas.owner[at] = owner.reshape(shape)
    return _outline(at, (seen.alpha > 0.5).reshape(shape))


def _outline(at: Area, mask: NDArray[np.bool_]) -> Box:
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if not len(rows):
        return 0.0, 0.0, 0.0, 0.0
    x, y = at[1].start + columns[0], at[0].start + rows[0]
    return float(x), float(y), float(columns[-1] + 1 - columns[0]), float(rows[-1] + 1 - rows[0])


def _shade(rng: np.random.Generator, seen: Seen, rays: Float, others: list[Placed], lights: Lights) -> Float:
    """(n,) light that the surface gives back."""
    normal = seen.normal
    sun = np.maximum(lights.sun @ normal, 0) * _lit(rays * seen.length_m, others, lights.sun)
    sky = np.float32(0.55) - np.float32(0.45) * normal[1]
    lamp = np.maximum(-(rays * normal).sum(0), 0)
    shade = np.float32(lights.sunny) * sun + np.float32(lights.sky) * sky + np.float32(lights.lamp) * lamp
    if rng.random() < 0.4:
        half = lights.sun[:, None] - rays
        half = half / np.sqrt((half * half).sum(0))
        gloss = np.maximum((half * normal).sum(0), 0) ** np.float32(rng.uniform(20, 200))
        shade = shade + np.float32(rng.uniform(0.2, 1.5)) * gloss
    result: Float = np.maximum(shade + np.float32(0.08), np.float32(0.05)).astype(np.float32)
    return result


def _lit(points_m: Float, others: list[Placed], sun: NDArray[np.float32]) -> Float:
    """(n,) 0..1: how much of the sun the others leave, with soft edges."""
    light = np.ones(points_m.shape[1], np.float32)
    for other in others:
        away = other.centre_m.astype(np.float32)[:, None] - points_m
        along = sun @ away
        miss = np.sqrt(np.maximum((away * away).sum(0) - along * along, 0)) / np.float32(SHADOW_PART * other.reach_m)
        soft = np.float32(0.15) + np.float32(0.15) * np.maximum(along, 0)
        covered = np.clip((1 - miss) / soft + np.float32(0.5), 0, 1) * (along > 0.5 * other.reach_m)
        light *= 1 - covered * np.float32(0.85)
    return light


def _shadow_backdrop(canvas: Canvas, scene: Scene) -> None:
    """Shadows on what is behind, at a quarter of the resolution, in place."""
    camera, lights = scene.camera, scene.lights
    height, width = camera.size
    rays = camera.rays((slice(0, height), slice(0, width))).reshape(3, height, width)[:, ::4, ::4]
    points = rays * canvas.distance_m[::4, ::4]
    lit = _lit(points.reshape(3, -1), scene.solids, lights.sun).reshape(points.shape[1:])
    whole = np.repeat(np.repeat(lit, 4, 0), 4, 1)[:height, :width]
    part = lights.sunny / (lights.sunny + lights.sky + 0.2)
    canvas.shading *= 1 - np.float32(part) * (1 - whole)
