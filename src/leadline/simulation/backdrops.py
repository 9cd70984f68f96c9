"""What stands behind the balls of a training picture: pool walls and floors, sea floor, open water, the surface."""

from __future__ import annotations

import cv2
import numpy as np

from leadline.simulation import textures
from leadline.simulation.optics import Float

Backdrop = tuple[Float, Float, Float]  # reflectance (h, w, 3), distance_m (h, w), shading (h, w)


def random_backdrop(rng: np.random.Generator, size: tuple[int, int]) -> Backdrop:
    kind = rng.choice(["wall", "pool", "floor", "open"], p=[0.3, 0.25, 0.25, 0.2])
    height, width = size
    distance = np.full(size, rng.uniform(2, 9), np.float32)
    shading = np.broadcast_to(np.linspace(1.0, rng.uniform(0.5, 1), height, dtype=np.float32)[:, None], size).copy()
    if kind == "open":
        distance[:] = 40.0
        return np.full((height, width, 3), 0.1, np.float32), distance, shading
    if kind == "wall":
        return _wall(rng, size), distance, shading
    wall = _wall(rng, size) if kind == "pool" else np.full((height, width, 3), 0.1, np.float32)
    if kind == "floor":
        distance[:] = 40.0
    _lay_floor(rng, wall, distance, pool=kind == "pool")
    if kind == "pool" and rng.random() < 0.5:
        _mirror(rng, wall)
    return wall, distance, shading


def _random_tile_texture(rng: np.random.Generator, count: int) -> Float:
    blue = np.array([rng.uniform(0.4, 0.9), rng.uniform(0.4, 0.8), rng.uniform(0.15, 0.8)], np.float32)
    texture = textures.tiles(rng, 512, blue, count, rng.uniform(0.1, 1.4))
    if rng.random() < 0.4:  # a dark lane mark
        at, thick = int(rng.integers(0, 400)), int(rng.integers(20, 100))
        texture[:, at : at + thick] *= np.float32(rng.uniform(0.1, 0.5))
    return texture


def _wall(rng: np.random.Generator, size: tuple[int, int]) -> Float:
    """Tiles seen somewhat askew."""
    texture = _random_tile_texture(rng, int(rng.choice([2, 4, 8, 16])))
    height, width = size
    zoom = rng.uniform(0.5, 2.0)
    look = np.array([[1, 0, -width / 2], [0, 1, -height / 2], [0, 0, 1]], float)
    tilt = np.eye(3)
    tilt[2, :2] = rng.normal(0, 0.25, 2) / width
    turn = rng.normal(0, 0.1)
    spin = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, zoom]])
    return _warp(texture, spin @ tilt @ look, size)


def _warp(texture: Float, look: np.ndarray[tuple[int, int], np.dtype[np.float64]], size: tuple[int, int]) -> Float:
    """Sample a tiling texture at the homography's places."""
    height, width = size
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    m = look.astype(np.float32)
    w = m[2, 0] * x + m[2, 1] * y + m[2, 2]
    w = np.where(np.abs(w) < 1e-3, np.float32(1e-3), w)
    u, v = (m[0, 0] * x + m[0, 1] * y + m[0, 2]) / w, (m[1, 0] * x + m[1, 1] * y + m[1, 2]) / w
    side = np.float32(len(texture))
    return textures.look_up(texture, u % side, v % side)


def _lay_floor(rng: np.random.Generator, picture: Float, distance_m: Float, pool: bool) -> None:
    """Cover everything below a horizon with a floor in perspective, in place."""
    height, width = distance_m.shape
    horizon = int(height * rng.uniform(0.2, 0.9))
    if pool:
        texture = _random_tile_texture(rng, int(rng.choice([4, 8])))
    else:
        colour = np.array([rng.uniform(0.1, 0.5), rng.uniform(0.2, 0.55), rng.uniform(0.2, 0.6)], np.float32)
        texture = textures.sand(rng, 512, colour, rng.uniform(0.2, 1.3))
    above = rng.uniform(0.5, 2.0)  # m over the floor
    rows = np.arange(horizon, height, dtype=np.float32)
    z = np.float32(above * 0.9 * width) / (rows - horizon + np.float32(0.1 * height if pool else 4))
    scale = np.float32(512 / rng.uniform(0.8, 3.0))
    x = (np.arange(width, dtype=np.float32)[None, :] - width / 2) / np.float32(0.9 * width) * z[:, None] * scale
    v = np.broadcast_to((z * scale)[:, None], x.shape)
    turn = rng.uniform(0, 2 * np.pi)
    cos, sin = np.float32(np.cos(turn)), np.float32(np.sin(turn))
    u2, v2 = cos * x - sin * v, sin * x + cos * v
    picture[horizon:] = textures.look_up(texture, u2 % 512, v2 % 512)
    distance_m[horizon:] = np.minimum(z, 40)[:, None]


def _mirror(rng: np.random.Generator, picture: Float) -> None:
    """The water's surface from below: the upper rows show the rest upside down, wavy, in place."""
    height, width = picture.shape[:2]
    line = int(height * rng.uniform(0.08, 0.3))
    y, x = np.meshgrid(np.arange(line, dtype=np.float32), np.arange(width, dtype=np.float32), indexing="ij")
    wave = np.sin(x / np.float32(rng.uniform(8, 30)) + y / np.float32(3)) * np.float32(rng.uniform(2, 8))
    look_y = np.clip(2 * line - y * np.float32(rng.uniform(0.6, 1.0)) + wave, 0, height - 1)
    picture[:line] = cv2.remap(picture, x + wave, look_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    picture[:line] *= np.float32(rng.uniform(0.8, 1.4))
