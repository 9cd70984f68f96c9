"""Pairs of pictures of textured surfaces, ray-traced through the port: true patches for the matching to be judged by.

Every pixel's ray meets the surface analytically, and the texture is a sum of plane waves in space, known exactly
anywhere: neither an interpolation nor the code under test stands between the truth and what is measured.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from leadline.ranging.images import Float32
from leadline.ranging.layout import predicted
from leadline.ranging.patches import Warp
from leadline.rig import Rig
from leadline.samples import Array
from leadline.target import Target

NOISE = 2.0  # grey levels, in each image
SPACING = 30
COLUMNS, ROWS = 12, 8
Texture = Callable[[Array], Array]  # points (N, 3), m -> grey levels (N,)


def waves(rng: np.random.Generator, pixel_m: float, contrast: float, finest_px: float = 6.0) -> Texture:
    """60 waves in all directions, 6 to 40 px of ``pixel_m`` long; standard deviation ``contrast``."""
    direction = rng.normal(size=(60, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    k = direction * (2 * np.pi / (pixel_m * rng.uniform(finest_px, 40.0, 60)))[:, None]
    phase, size = rng.uniform(0, 2 * np.pi, 60), contrast * np.sqrt(2 / 60)
    return lambda p: 120.0 + size * np.cos(p @ k.T + phase).sum(axis=1)


@dataclass(frozen=True)
class Scene:
    """Both pictures' parts with the patches (12 x 8 centres, ``SPACING`` apart), and the truth."""

    rig: Rig
    left: Float32
    right: Float32
    left_corner_px: Array
    right_corner_px: Array
    surface: Target
    x: Array
    texture: Texture

    @property
    def centres_px(self) -> Array:
        """(N, 2) whole pixels of the left part."""
        v, u = np.mgrid[1 : ROWS + 1, 1 : COLUMNS + 1]
        return np.asarray(SPACING * np.stack([u.ravel(), v.ravel()], axis=1), float)

    def points(self, q_px: Array, side: str = "left") -> Array:
        """What pixels (N, 2) of a part see (N, 3), m."""
        corner = self.left_corner_px if side == "left" else self.right_corner_px
        origins, directions = self.rig.rays(q_px + corner, side)  # type: ignore[arg-type]
        length = self.surface.beam_length(self.x, origins, directions)[0]
        return np.asarray(origins + length[:, None] * directions)

    def true_right_px(self) -> Array:
        """Where the patches' centres are in the right part (N, 2)."""
        return self.rig.project(self.points(self.centres_px))[1] - self.right_corner_px

    def warp(self, half: int, believed: Array) -> Warp:
        """Where a prediction has the patches."""
        flat = _Whole(self.left_corner_px)
        warp = predicted(
            self.rig, flat, self.centres_px, half, lambda o, d: self.surface.beam_length(believed, o, d)[0]
        ).warp
        return Warp(warp.centre_px, half, warp.expected_px - self.right_corner_px, warp.bend, warp.along)


@dataclass(frozen=True)
class _Whole:
    """As much of a ``Region`` as the layout asks of it."""

    corner_px: Array
    level: int = 0

    def to_full(self, q_px: Array) -> Array:
        return np.asarray(q_px + self.corner_px)


def render(rig: Rig, surface: Target, x: Array, texture: Texture, at_px: Array, room_px: int = 30) -> Scene:
    """Noiseless pictures of a surface, around a pixel of the left image."""
    size = np.array([SPACING * (COLUMNS + 1), SPACING * (ROWS + 1)])
    corner = np.round(at_px - size / 2)
    origins, directions = rig.rays(corner + _grid(size)[::97])
    length = surface.beam_length(x, origins, directions)[0]
    seen = rig.project(origins + length[:, None] * directions)[1]
    low, high = np.floor(np.nanmin(seen, axis=0)) - room_px, np.ceil(np.nanmax(seen, axis=0)) + room_px
    empty = np.empty((0, 0), np.float32)
    scene = Scene(rig, empty, empty, corner, low, surface, x, texture)
    left = texture(scene.points(_grid(size))).reshape(size[::-1])
    right_size = (high - low).astype(int)
    right = texture(scene.points(_grid(right_size), "right")).reshape(right_size[::-1])
    left, right = (np.asarray(np.nan_to_num(i, nan=60.0), np.float32) for i in (left, right))  # around it: dark water
    return Scene(rig, left, right, corner, low, surface, x, texture)


def _grid(size: Array) -> Array:
    v, u = np.mgrid[0 : int(size[1]), 0 : int(size[0])]
    return np.stack([u.ravel(), v.ravel()], axis=1).astype(float)


def noisy(image: Float32, rng: np.random.Generator, noise: float = NOISE) -> Float32:
    """As a camera gives it: noise, and whole grey levels from 0 to 255."""
    return np.asarray(np.clip(np.round(image + rng.normal(0, noise, image.shape)), 0, 255), np.float32)


def bound_px(scene: Scene, warp: Warp, noise: float = NOISE) -> Array:
    """Cramer-Rao limit (N,) of a patch's shift, with slants, gain and level unknown and both images' noise.

    The noiseless texture's slope is taken from the scene itself, a hundredth of a pixel to each side.
    """
    line = np.arange(-warp.half, warp.half + 1.0)
    dx, dy = (v.ravel() for v in np.meshgrid(line, line))
    back = np.linalg.solve(warp.bend[:, :, :2], warp.along[:, :, None])[:, :, 0]
    limits = []
    for centre, by in zip(warp.centre_px, back, strict=True):
        q_px = centre + np.stack([dx, dy], axis=1)
        here, ahead, behind = (scene.texture(scene.points(q_px + s * by)) for s in (0.0, 0.01, -0.01))
        slope = (ahead - behind) / 0.02
        design = np.stack([slope, slope * dx / warp.half, slope * dy / warp.half, here, np.ones_like(here)], axis=1)
        limits.append(np.linalg.inv(design.T @ design)[0, 0])
    return np.sqrt(2 * (noise**2 + 1 / 12) * np.array(limits))


def tiles(rng: np.random.Generator, pixel_m: float, stripes: bool) -> Texture:
    """Stripes or a checker of 6 to 16 px, at any angle up to 40 degrees."""
    period, turn, phase = rng.uniform(6, 16) * pixel_m, rng.uniform(-0.7, 0.7), rng.uniform(0, 2 * np.pi, 2)
    across, down = np.array([np.cos(turn), np.sin(turn), 0]), np.array([-np.sin(turn), np.cos(turn), 0])

    def texture(p: Array) -> Array:
        wave = np.sin(2 * np.pi * (p @ across) / period + phase[0])
        other = 1.0 if stripes else np.sin(2 * np.pi * (p @ down) / period + phase[1])
        return np.asarray(120 + 40 * np.tanh(3 * wave * other))

    return texture


def particles(image: Float32, rng: np.random.Generator) -> Float32:
    """Marine snow: bright blobs of 1 to 8 px, of which the other image has others."""
    seen = image.copy()
    height, width = image.shape
    for _ in range(image.size // 1500):
        sigma, bright = rng.uniform(0.7, 4.0), rng.uniform(20, 120)
        u, v = rng.uniform(0, width), rng.uniform(0, height)
        rows, columns = (
            slice(*np.clip([int(c - 4 * sigma), int(c + 4 * sigma) + 1], 0, n)) for c, n in ((v, height), (u, width))
        )
        y, x = np.mgrid[rows, columns]
        seen[rows, columns] += bright * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * sigma**2))
    return seen


def behind_bars(scene: Scene, near_x: Array, texture: Texture, width_m: float, turn: float) -> tuple[Scene, Array]:
    """Bars of a nearer surface before a scene; and where what each patch's centre sees is in the right part (N, 2)."""
    across = np.array([np.cos(turn), np.sin(turn), 0])
    near = Scene(
        scene.rig, scene.left, scene.right, scene.left_corner_px, scene.right_corner_px, scene.surface, near_x, texture
    )

    def covered(p: Array) -> Array:
        return np.asarray(np.sin(np.pi * (p @ across) / width_m) > 0.3)

    parts = []
    for side, image in (("left", scene.left), ("right", scene.right)):
        p = near.points(_grid(np.array(image.shape[::-1])), side)
        parts.append(np.where(covered(p), texture(p), image.ravel()).reshape(image.shape).astype(np.float32))
    hidden = covered(near.points(near.centres_px))
    seen = np.where(hidden[:, None], near.true_right_px(), scene.true_right_px())
    return Scene(scene.rig, *parts, scene.left_corner_px, scene.right_corner_px, scene.surface, scene.x, texture), seen
