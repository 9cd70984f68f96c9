"""Surfaces' textures: noise of many scales, cracks, stains, tiles, sand, caustics. Images tile at their borders."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from leadline.simulation.optics import Float, f32


def noise(rng: np.random.Generator, size: int, cells: int = 4, octaves: int = 6, roughness: float = 0.55) -> Float:
    """(size, size) fractal noise that tiles, mean 0, standard deviation 1; ``cells`` across at the coarsest octave."""
    total = np.zeros((min(size, 4 * cells),) * 2, np.float32)
    amplitude = 1.0
    for _ in range(octaves):
        if cells > size:
            break
        side = min(size, 4 * cells)  # enough for this octave: the finest ones alone are made at full size
        total = _smooth_grid(total, side) if side > len(total) else total
        total += np.float32(amplitude) * _smooth_grid(rng.standard_normal((cells, cells), np.float32), side)
        cells, amplitude = cells * 2, amplitude * roughness
    total = _smooth_grid(total, size) if size > len(total) else total
    total -= total.mean()
    total /= total.std() + np.float32(1e-6)
    return total


def _smooth_grid(grid: Float, size: int) -> Float:
    """Cubic interpolation of a grid to (size, size), wrapping round."""
    cells, margin = len(grid), 2
    padded = np.pad(grid, margin, mode="wrap")
    scale = size / cells
    # Output pixel x looks at grid position (x + 0.5) / scale - 0.5, shifted by the margin.
    affine = np.array([[1 / scale, 0, 0.5 / scale - 0.5 + margin], [0, 1 / scale, 0.5 / scale - 0.5 + margin]])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    return f32(cv2.warpAffine(padded, affine, (size, size), flags=flags, borderMode=cv2.BORDER_REPLICATE))


def look_up(texture: Float, x: Float, y: Float) -> Float:
    """Bilinear values of a tiling texture at its pixels (x, y)."""
    return f32(cv2.remap(texture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP))


def cracks(rng: np.random.Generator, size: int, count: int, length: float, width: float) -> Float:
    """(size, size) in 0..1: ``count`` wandering lines; ``length`` and ``width`` as fractions of the size."""
    mask = np.zeros((size, size), np.uint8)
    shift = 4  # fractional bits of OpenCV's drawing
    for _ in range(count):
        steps = int(rng.integers(4, 10))
        heading = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0, 0.35, steps))
        stride = length * size * rng.uniform(0.3, 1.0) / steps
        walk = np.cumsum(np.stack([np.cos(heading), np.sin(heading)], 1) * stride, axis=0)
        points = rng.uniform(0, size, 2) + walk
        thickness = max(1, round(width * size * rng.uniform(0.4, 1.3)))
        for wrap in _wraps(points, size):
            line = np.round((points + wrap) * (1 << shift)).astype(np.int32)
            cv2.polylines(mask, [line], False, int(rng.integers(140, 256)), thickness, cv2.LINE_AA, shift)
    return mask.astype(np.float32) / np.float32(255)


def _wraps(points: NDArray[np.float64], size: int) -> list[tuple[int, int]]:
    """The shifts by the texture's size under which the points touch the texture."""
    low, high = points.min(0), points.max(0)
    return [
        (i * size, j * size)
        for i in (-1, 0, 1)
        for j in (-1, 0, 1)
        if high[0] + i * size >= 0 and low[0] + i * size < size and high[1] + j * size >= 0 and low[1] + j * size < size
    ]


def worn_paint(
    rng: np.random.Generator, size: int, colour_bgr: Float, contrast: float, *, octaves: int = 8, lines: float = 1.0
) -> Float:
    """(size, size, 3) reflectance of a painted or plastic surface with blotches, grain, cracks and scratches.

    ``contrast`` 0 gives one even colour, 1 the look of a ball that has been in the sea for a year. ``lines`` scales the
    cracks, whose lengths are fractions of the texture.
    """
    shade = np.float32(0.14 * contrast) * noise(rng, size, 6, octaves, 0.62)
    shade += np.float32(0.09 * contrast) * noise(rng, size, max(16, size // 16), 4, 0.8)
    shade = np.exp(shade)
    if contrast == 0:
        even: Float = colour_bgr * shade[..., None]
        return even
    stain = np.clip(noise(rng, size, 5, 5, 0.6) - np.float32(0.9), 0, 1) * np.float32(0.5)
    dark = cracks(rng, size, round(16 / lines), 0.2 * lines, 0.0025 * lines) * np.float32(0.8)
    light = cracks(rng, size, round(8 / lines), 0.13 * lines, 0.004 * lines) * np.float32(0.8 * min(contrast, 1.0))
    shade *= 1 - np.maximum(stain, dark) * np.float32(min(contrast, 1.0))
    picture: Float = colour_bgr * (shade * (1 - light))[..., None]
    picture += (np.float32(0.4) * colour_bgr + np.float32(0.4)) * light[..., None]
    return picture


def tiles(rng: np.random.Generator, size: int, colour_bgr: Float, count: int = 8, contrast: float = 1.0) -> Float:
    """(size, size, 3) pool tiles: ``count`` a side, each of its own shade, with darker grout."""
    shade = np.kron(rng.normal(0, 0.05 * contrast, (count, count)), np.ones((size // count, size // count)))
    shade = f32(cv2.resize(f32(shade), (size, size), interpolation=cv2.INTER_NEAREST))
    shade += np.float32(0.05 * contrast) * noise(rng, size, 4, 7, 0.65)
    at = np.arange(size) % (size / count)
    half = 0.022 * size / count
    edge = np.clip(half + 0.5 - np.minimum(at, size / count - at), 0, 1).astype(np.float32)
    grout = np.maximum(edge[None, :], edge[:, None])
    picture: Float = colour_bgr * (np.exp(shade) * (1 - np.float32(min(0.8, 0.6 * contrast)) * grout))[..., None]
    return picture


def sand(rng: np.random.Generator, size: int, colour_bgr: Float, contrast: float = 1.0) -> Float:
    """(size, size, 3) sea floor: mounds, pebbles, dark weed."""
    shade = np.exp(np.float32(0.28 * contrast) * noise(rng, size, 4, 9, 0.7))
    weed = np.clip(noise(rng, size, 8, 7, 0.6) * np.float32(1.5) - np.float32(1.5), 0, 1)
    shade *= 1 - np.float32(min(0.9, 0.7 * contrast)) * weed
    pebble = np.clip(noise(rng, size, max(8, size // 24), 2, 0.5) * np.float32(2) - np.float32(3.2), 0, 1)
    picture: Float = colour_bgr * (shade * (1 + np.float32(contrast) * pebble))[..., None]
    return picture


def caustic(rng: np.random.Generator, size: int) -> Float:
    """(size, size) light under waves, mean 1: a net of bright lines of uneven strength over a soft glow."""
    pattern = np.zeros((size, size), np.float32)
    for cells, weight in ((4, 1.0), (7, 0.7)):
        ridge = np.exp(np.float32(-5) * np.abs(noise(rng, size, cells, 3, 0.4)))
        strength = np.clip(np.float32(0.6) + np.float32(0.5) * noise(rng, size, cells, 2, 0.5), 0, 2)
        pattern += np.float32(weight) * ridge * strength
    pattern += np.float32(0.35) * pattern.mean()
    result: Float = pattern / np.float32(pattern.mean())
    return result
