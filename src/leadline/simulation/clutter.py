"""Things in a training picture that are not balls: boxes, pipes, ropes, rings, bars, plants."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from leadline.simulation.optics import Float, f32

Paint = Callable[[tuple[slice, slice], Float, Float, Float, Float], None]
Mask = np.ndarray[tuple[int, int], np.dtype[np.uint8]]


def add_clutter(rng: np.random.Generator, paint: Paint, size: tuple[int, int]) -> None:
    """Paint none to six things."""
    shapes = (_box, _pipe, _rope, _ring, _plant)
    for _ in range(int(rng.integers(0, 7))):
        if rng.random() < 0.45:
            continue
        mask = np.zeros(size, np.uint8)
        shading = shapes[int(rng.integers(len(shapes)))](rng, mask)
        x, y, w, h = cv2.boundingRect(mask)
        at = (slice(y, y + h), slice(x, x + w))
        alpha = mask[at].astype(np.float32) / np.float32(255)
        colour = rng.uniform(0.02, 0.8, 3).astype(np.float32)
        if rng.random() < 0.5:
            colour[:] = colour.mean()
        shading = shading[at] if shading.shape == size else shading
        paint(at, colour, alpha, f32([[rng.uniform(0.5, 6)]]), shading)


def _corners(
    points: np.ndarray[tuple[int, int], np.dtype[np.float64]],
) -> list[np.ndarray[tuple[int, ...], np.dtype[np.int32]]]:
    return [np.round(points * 16).astype(np.int32)]


def _strip(rng: np.random.Generator, mask: Mask, width_range: tuple[float, float]) -> Float:
    """A turned rectangle; returns the place across it, -1..1 (h, w)."""
    height, width = mask.shape
    centre = rng.uniform(0, 1, 2) * [width, height]
    half = np.array([rng.uniform(0.05, 0.7) * width, rng.uniform(*width_range) * width])
    angle = rng.uniform(0, np.pi) if rng.random() < 0.5 else rng.choice([0, np.pi / 2]) + rng.normal(0, 0.08)
    along = np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    corners = [centre + s * half[0] * along + t * half[1] * across for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    cv2.fillPoly(mask, _corners(np.array(corners)), 255, cv2.LINE_AA, 4)
    x = (np.arange(width, dtype=np.float32) - np.float32(centre[0]))[None, :]
    y = (np.arange(height, dtype=np.float32) - np.float32(centre[1]))[:, None]
    place: Float = np.clip((x * np.float32(across[0]) + y * np.float32(across[1])) / np.float32(half[1]), -1, 1)
    return place


def _box(rng: np.random.Generator, mask: Mask) -> Float:
    place = _strip(rng, mask, (0.05, 0.25))
    shade: Float = np.float32(rng.uniform(0.3, 1.0)) + np.float32(rng.uniform(-0.2, 0.2)) * place
    return shade


def _pipe(rng: np.random.Generator, mask: Mask) -> Float:
    place = _strip(rng, mask, (0.01, 0.12))
    shade: Float = np.sqrt(np.maximum(1 - place * place, 0)) * np.float32(rng.uniform(0.5, 1.1))
    return shade


def _rope(rng: np.random.Generator, mask: Mask) -> Float:
    height, width = mask.shape
    start, end = rng.uniform(-0.1, 1.1, 2) * [width, height], rng.uniform(-0.1, 1.1, 2) * [width, height]
    t = np.linspace(0, 1, 20)[:, None]
    sag = np.array([rng.normal(0, 0.1) * width, rng.normal(0, 0.1) * height])
    points = start + (end - start) * t + sag * (4 * t * (1 - t))
    cv2.polylines(mask, _corners(points), False, 255, int(rng.integers(1, 7)), cv2.LINE_AA, 4)
    return np.full((1, 1), rng.uniform(0.3, 1), np.float32)


def _ring(rng: np.random.Generator, mask: Mask) -> Float:
    """A hoop, open in the middle."""
    height, width = mask.shape
    centre = (rng.uniform(0, 1, 2) * [width, height] * 16).astype(int)
    axes = (np.array([1, rng.uniform(0.3, 1)]) * rng.uniform(0.05, 0.3) * width * 16).astype(int)
    thick = max(1, int(axes[1] / 16 * rng.uniform(0.05, 0.25)))
    turn = rng.uniform(0, 180)
    cv2.ellipse(mask, (centre[0], centre[1]), (axes[0], axes[1]), turn, 0, 360, 255, thick, cv2.LINE_AA, 4)
    return np.full((1, 1), rng.uniform(0.3, 1), np.float32)


def _plant(rng: np.random.Generator, mask: Mask) -> Float:
    """Blades from below."""
    height, width = mask.shape
    foot = rng.uniform(0, width)
    for _ in range(int(rng.integers(3, 15))):
        t = np.linspace(0, 1, 8)
        lean, tall = rng.normal(0, 0.15) * width, rng.uniform(0.1, 0.5) * height
        points = np.stack([foot + rng.normal(0, 8) + lean * t**2, height - tall * t], 1)
        cv2.polylines(mask, _corners(points), False, 255, int(rng.integers(1, 5)), cv2.LINE_AA, 4)
    return np.full((1, 1), rng.uniform(0.2, 0.8), np.float32)
