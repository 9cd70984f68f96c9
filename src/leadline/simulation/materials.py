"""What surfaces are painted with: textures in metres on the surface, filtered for the distance (trilinear mip maps)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from leadline.simulation import textures
from leadline.simulation.optics import Float, f32, spread
from leadline.simulation.scenario import BackdropPart, TargetPart

_PAD = 4  # texels around each level, so that interpolation wraps


class Atlas:
    """A tiling texture with all its halvings side by side in one picture: two lookups give any mixture of scales."""

    def __init__(self, texture: Float, period_m: float) -> None:
        """``texture`` (S, S) or (S, S, 3), S a power of two; it repeats every ``period_m``."""
        self.period_m, self.size = period_m, len(texture)
        levels = [texture]
        while len(levels[-1]) > 4:
            levels.append(f32(cv2.resize(levels[-1], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)))
        padded = [np.pad(level, [(_PAD, _PAD)] * 2 + [(0, 0)] * (level.ndim - 2), mode="wrap") for level in levels]
        lefts = np.cumsum([0, *(level.shape[1] for level in padded)])
        self.picture = np.zeros((len(padded[0]), lefts[-1], *texture.shape[2:]), np.float32)
        for level, left in zip(padded, lefts, strict=False):
            self.picture[: len(level), left : left + level.shape[1]] = level
        self._left = (lefts[:-1] + _PAD - 0.5).astype(np.float32)
        self._side = np.array([len(level) for level in levels], np.float32)

    def sample(self, u_m: Float, v_m: Float, footprint_m: Float | float) -> Float:
        """The texture's mean over about ``footprint_m`` at places (h, w) on the surface."""
        u, v = u_m * np.float32(1 / self.period_m), v_m * np.float32(1 / self.period_m)
        u -= np.floor(u)
        v -= np.floor(v)
        last = len(self._side) - 1
        level = np.log(f32(footprint_m) * np.float32(self.size / self.period_m)) * np.float32(1 / np.log(2))
        level = np.clip(level, 0, last)
        low = level.astype(np.int32)
        if low.min() == low.max():  # one scale for all: no table
            low = np.asarray(low.flat[0])
        fine = self._look_up(u, v, low)
        if level.max() < 0.02:
            return fine
        coarse = self._look_up(u, v, np.minimum(low + 1, last))
        coarse -= fine
        rest = f32(np.broadcast_to(level - low, u.shape))
        coarse *= rest if fine.ndim == 2 else spread(rest)
        fine += coarse
        return fine

    def _look_up(self, u: Float, v: Float, level: NDArray[np.int32]) -> Float:
        side = self._side.take(level)
        x = u * side
        x += self._left.take(level)
        y = v * side
        y += np.float32(_PAD - 0.5)
        return f32(cv2.remap(self.picture, x, y, cv2.INTER_LINEAR))


class Material:
    """A coloured texture, and a finer grey one that keeps close-ups from blurring."""

    def __init__(self, base: Atlas, grain: Atlas | None) -> None:
        self._base, self._grain = base, grain

    def reflectance(self, u_m: Float, v_m: Float, footprint_m: Float) -> Float:
        """(h, w, 3) BGR."""
        colour = self._base.sample(u_m, v_m, footprint_m)
        if self._grain is None:
            return colour
        colour *= spread(self._grain.sample(u_m, v_m, footprint_m))
        return colour


def _grain(rng: np.random.Generator, strength: float, period_m: float) -> Atlas | None:
    if strength == 0:
        return None
    size = 1024
    fine = np.float32(0.10 * strength) * textures.noise(rng, size, 32, 5, 0.8)
    specks = np.clip(textures.noise(rng, size, 80, 3, 0.6) - np.float32(1.9), 0, 1)
    scratches = textures.cracks(rng, size, 40, 0.15, 0.0015)
    picture = np.exp(fine) * (1 - np.float32(min(0.5, 0.4 * strength)) * np.maximum(specks, scratches))
    return Atlas(picture / np.float32(picture.mean()), period_m)


def target_material(target: TargetPart, rng: np.random.Generator, size: int) -> Material:
    """The target's skin. ``size``: texels a side of the coloured texture."""
    colour = f32(target.colour[::-1])
    grain = _grain(rng, min(1.0, target.contrast) * target.detail, 0.21)
    if target.shape == "plane":
        return Material(Atlas(_hull_paint(rng, size, colour, target.contrast), 4.0), grain)
    if target.shape == "cylinder":
        return Material(Atlas(_pile_crust(rng, size, colour, target.contrast), 1.5), grain)
    period_m = 3.2 * target.diameter_m / 2  # the chart of a ball is 2 sqrt(2) radii wide
    return Material(Atlas(textures.worn_paint(rng, size, colour, target.contrast, octaves=9), period_m), grain)


def _hull_paint(rng: np.random.Generator, size: int, colour: Float, contrast: float) -> Float:
    """Plates with weld seams, patches of bare primer, barnacles."""
    paint = textures.worn_paint(rng, size, colour, contrast, octaves=9, lines=0.3)
    at = np.arange(size) * (4 / size)  # metres
    seam = np.minimum(np.abs(at[None, :] % 2 - 0.3), np.abs(at[:, None] % 1.0 - 0.4))
    weld = np.exp(np.float32(-0.5) * f32(seam / 0.006) ** 2) * (1 + np.float32(0.3) * textures.noise(rng, size, 256, 2))
    primer = np.clip(3 * textures.noise(rng, size, 10, 7, 0.6) - np.float32(5.5), 0, 1)
    barnacles = np.clip(3 * textures.noise(rng, size, size // 10, 2, 0.4) - np.float32(5.5), 0, 1)
    barnacles *= np.clip(textures.noise(rng, size, 5, 4, 0.5) + np.float32(0.4), 0, 1)
    amount = np.float32(min(1.0, contrast))
    paint *= spread(1 - np.float32(0.4) * amount * weld)
    paint += (f32([0.34, 0.36, 0.38]) - paint) * spread(np.float32(0.6) * amount * np.maximum(primer, barnacles))
    return paint


def _pile_crust(rng: np.random.Generator, size: int, colour: Float, contrast: float) -> Float:
    """Concrete or steel with weed and mussels."""
    paint = textures.worn_paint(rng, size, colour, contrast, octaves=9, lines=0.5)
    weed = np.clip(textures.noise(rng, size, 6, 8, 0.68) + np.float32(0.2), 0, 1)
    mussels = np.clip(2 * textures.noise(rng, size, size // 16, 3, 0.6) - np.float32(2.2), 0, 1)
    amount = np.float32(min(1.0, contrast))
    tufts = np.exp(np.float32(0.35) * textures.noise(rng, size, size // 16, 4, 0.8))
    paint += (f32([0.06, 0.16, 0.11]) * tufts[..., None] - paint) * (np.float32(0.75) * amount * weed)[..., None]
    paint *= (1 - np.float32(0.7) * amount * mussels)[..., None]
    return paint


def backdrop_material(backdrop: BackdropPart, rng: np.random.Generator) -> Material:
    colour = f32(backdrop.colour[::-1])
    if backdrop.kind == "pool":
        return Material(Atlas(textures.tiles(rng, 1024, colour, 8, backdrop.contrast), 2.4), None)
    return Material(Atlas(textures.sand(rng, 1024, colour, backdrop.contrast), 3.0), None)
