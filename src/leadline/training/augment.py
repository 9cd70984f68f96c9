"""Training pictures out of examples: mosaics, scale, flip, water and camera changes. Boxes follow; no torch.

A picture is an image (H, W, 3) uint8 BGR with boxes (N, 4) x0 y0 x1 y1 and classes (N,); class -1 marks a place where
an unlabelled target may be.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Ints = NDArray[np.int64]
Bytes = NDArray[np.uint8]
Rng = np.random.Generator

SMALLEST_PX = 6.0  # a box with a shorter side is not taught
LEAST_VISIBLE = 0.25  # a small box cut to less than this part is not taught
GREY = 114


@dataclass(frozen=True, slots=True)
class Picture:
    image: Bytes
    boxes: Floats
    classes: Ints


def placed(picture: Picture, matrix: Floats, size: tuple[int, int]) -> Picture:
    """``picture`` moved by ``matrix`` (2, 3), corner pixels to corner pixels, axis-parallel, onto ``size`` (w, h)."""
    centre_shift = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    whole = np.vstack([matrix, [0, 0, 1]])
    pixel_matrix = (np.linalg.inv(centre_shift) @ whole @ centre_shift)[:2]
    shrink = abs(matrix[0, 0])
    image = picture.image
    if shrink < 0.6:  # warpAffine does not average: blur first
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), 0.35 / shrink), np.uint8)
    image = np.asarray(
        cv2.warpAffine(image, pixel_matrix, size, flags=cv2.INTER_LINEAR, borderValue=(GREY, GREY, GREY)), np.uint8
    )
    x = np.sort(picture.boxes[:, 0::2] * matrix[0, 0] + matrix[0, 2], 1)
    y = np.sort(picture.boxes[:, 1::2] * matrix[1, 1] + matrix[1, 2], 1)
    boxes = np.stack([x[:, 0], y[:, 0], x[:, 1], y[:, 1]], 1).astype(np.float32)
    return clipped(Picture(image, boxes, picture.classes))


def clipped(picture: Picture) -> Picture:
    """Boxes cut to the image; what is hardly left is dropped. Large boxes stay however little of them is seen."""
    height, width = picture.image.shape[:2]
    limit = np.array([width, height, width, height], np.float32)
    boxes = np.clip(picture.boxes, 0, limit)
    sides, sides_before = boxes[:, 2:] - boxes[:, :2], picture.boxes[:, 2:] - picture.boxes[:, :2]
    visible = sides.prod(1) / np.maximum(sides_before.prod(1), 1e-6)
    keep = (sides.min(1) >= SMALLEST_PX) & ((visible >= LEAST_VISIBLE) | (sides.min(1) >= width / 8))
    return Picture(picture.image, boxes[keep], picture.classes[keep])


def framed(rng: Rng, picture: Picture, size: tuple[int, int], fill: bool = False) -> Picture:
    """The picture as a whole or a part of it, at a random scale, perhaps mirrored, on ``size`` (w, h).

    ``fill``: at about the scale that covers ``size``, else about the one that fits into it.
    """
    height, width = picture.image.shape[:2]
    ratios = size[0] / width, size[1] / height
    scale = max(ratios) if fill else min(ratios)
    if rng.random() < 0.7:
        scale *= float(np.exp(rng.uniform(np.log(0.7), np.log(1.6))))
    squeeze = float(np.exp(rng.normal(0, 0.08)))
    sx, sy = scale * squeeze**0.5, scale / squeeze**0.5
    tx = rng.uniform(*sorted((0.0, size[0] - sx * width)))
    ty = rng.uniform(*sorted((0.0, size[1] - sy * height)))
    matrix = np.array([[sx, 0, tx], [0, sy, ty]])
    if rng.random() < 0.5:
        matrix = np.array([[-sx, 0, tx + sx * width], [0, sy, ty]])
    return placed(picture, matrix.astype(np.float32), size)


def single(rng: Rng, draw: Callable[[], Picture], size: tuple[int, int]) -> Picture:
    """One picture, in other water."""
    picture = framed(rng, draw(), size)
    return Picture(other_water(rng, picture.image), picture.boxes, picture.classes)


def mosaic(rng: Rng, draw: Callable[[], Picture], size: tuple[int, int]) -> Picture:
    """Four pictures around a random cross."""
    width, height = size
    cross_x, cross_y = int(width * rng.uniform(0.3, 0.7)), int(height * rng.uniform(0.3, 0.7))
    canvas = np.full((height, width, 3), GREY, np.uint8)
    parts: list[Picture] = []
    for x0, y0, x1, y1 in (
        (0, 0, cross_x, cross_y),
        (cross_x, 0, width, cross_y),
        (0, cross_y, cross_x, height),
        (cross_x, cross_y, width, height),
    ):
        part = framed(rng, draw(), (x1 - x0, y1 - y0), fill=True)
        canvas[y0:y1, x0:x1] = other_water(rng, part.image)
        shift = np.array([x0, y0, x0, y0], np.float32)
        parts.append(Picture(part.image, part.boxes + shift, part.classes))
    return Picture(canvas, np.concatenate([p.boxes for p in parts]), np.concatenate([p.classes for p in parts]))


def other_water(rng: Rng, image: Bytes) -> Bytes:
    """The same scene through other water and another camera: wash, haze, gain, gamma, saturation, blur, noise."""
    mix, shift = np.eye(3), np.zeros(3)  # colour' = mix @ colour + shift
    if rng.random() < 0.7:
        mix = np.diag(rng.uniform(0.75, 1.25, 3))
    if rng.random() < 0.5:
        saturation = rng.uniform(0.3, 1.5)
        mix = (np.full((3, 3), (1 - saturation) / 3) + saturation * np.eye(3)) @ mix
    if rng.random() < 0.35:  # haze of the scene's own colour: low contrast
        haze = mix @ np.array(cv2.mean(image)[:3]) * rng.uniform(0.8, 1.2, 3)
        clear = rng.uniform(0.25, 0.9)
        mix, shift = mix * clear, haze * (1 - clear)
    gain = rng.uniform(0.7, 1.15)
    out = np.asarray(cv2.transform(image, gain * np.column_stack([mix, shift])), np.uint8)
    out = np.asarray(cv2.LUT(out, _gamma(rng.uniform(0.75, 1.35))), np.uint8)
    if rng.random() < 0.25:
        out = np.asarray(cv2.GaussianBlur(out, (0, 0), rng.uniform(0.4, 1.6)), np.uint8)
    if rng.random() < 0.5:
        noise = rng.standard_normal(out.shape, np.float32) * np.float32(rng.uniform(0.8, 7.0))
        out = np.asarray(cv2.add(out, noise, dtype=cv2.CV_8U), np.uint8)
    return out


def _gamma(power: float) -> Bytes:
    return np.clip((np.arange(256) / 255) ** power * 255 + 0.5, 0, 255).astype(np.uint8)
