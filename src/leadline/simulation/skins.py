"""Paint on solids: a colour for each point of the surface: even, bands, sectors, checks, spots, signs."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import cv2
import numpy as np

from leadline.simulation import textures
from leadline.simulation.optics import Float

Pattern = Callable[[np.random.Generator, Float], Float]

PAINTS_BGR = (  # linear reflectance
    (0.03, 0.22, 0.75),  # orange
    (0.04, 0.04, 0.65),  # red
    (0.05, 0.60, 0.75),  # yellow
    (0.10, 0.50, 0.10),  # green
    (0.75, 0.75, 0.75),  # white
    (0.10, 0.10, 0.10),  # black
    (0.50, 0.15, 0.05),  # blue
    (0.45, 0.20, 0.70),  # pink
    (0.35, 0.35, 0.35),  # grey
    (0.10, 0.20, 0.32),  # brown
)
SIDE = 256


def random_paint(rng: np.random.Generator) -> Float:
    """(3,) BGR reflectance: one of the usual paints, worn, or any colour."""
    if rng.random() < 0.25:
        return rng.uniform(0.03, 0.8, 3).astype(np.float32)
    paint = np.array(PAINTS_BGR[int(rng.integers(len(PAINTS_BGR)))])
    return np.clip(paint * rng.uniform(0.6, 1.25) + rng.normal(0, 0.03, 3), 0.02, 0.9).astype(np.float32)


@lru_cache(maxsize=1)
def _wear() -> tuple[Float, ...]:
    """Sixteen grey textures (SIDE, SIDE) around 1 of dirt, growth, cracks and grain, weak to strong."""
    rng = np.random.default_rng(0)
    grey = np.ones(3, np.float32)
    return tuple(
        np.ascontiguousarray(textures.worn_paint(rng, SIDE, grey, contrast, octaves=6)[..., 0])
        for contrast in (0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.5, 2.0) * 2
    )


def painted(rng: np.random.Generator, points: Float, board: bool = False) -> Float:
    """(n, 3) BGR reflectance at a solid's own points (3, n), most of them within 1 of its origin."""
    first = random_paint(rng)
    colour = np.broadcast_to(first, (points.shape[1], 3)).copy()
    if board or rng.random() < 0.45:
        patterns: tuple[Pattern, ...] = (_bands, _sectors, _checks, _spots, _sign)
        pattern = _checks if board and rng.random() < 0.7 else patterns[int(rng.integers(len(patterns)))]
        second = random_paint(rng)
        if board and rng.random() < 0.7:
            first, second = np.full(3, 0.8, np.float32), np.full(3, 0.05, np.float32)
        share = pattern(rng, points)[:, None]
        colour = first + (second - first) * share
    if rng.random() < 0.75:
        wear = _wear()[int(rng.integers(16))]
        look = rng.normal(0, 1, (2, 3)).astype(np.float32) * np.float32(0.3 * SIDE)
        x, y = look @ points + rng.uniform(0, SIDE, (2, 1)).astype(np.float32)
        colour *= _look_up(wear, x, y)[:, None]
    result: Float = np.clip(colour, 0.01, 0.95)
    return result


def _look_up(texture: Float, x: Float, y: Float) -> Float:
    found: Float = texture[y.astype(np.int32) % SIDE, x.astype(np.int32) % SIDE]
    return found


def _axis(rng: np.random.Generator) -> Float:
    axis = rng.normal(0, 1, 3)
    unit: Float = (axis / np.linalg.norm(axis)).astype(np.float32)
    return unit


def _step(values: Float, soft: float = 0.02) -> Float:
    """0 below zero, 1 above, with an edge that is not quite sharp."""
    edge: Float = np.clip(values / np.float32(soft) + np.float32(0.5), 0, 1)
    return edge


def _bands(rng: np.random.Generator, p: Float) -> Float:
    """One band or many, across a random axis."""
    along = _axis(rng) @ p
    if rng.random() < 0.5:
        return _step(np.float32(rng.uniform(0.05, 0.35)) - np.abs(along - np.float32(rng.uniform(-0.5, 0.5))))
    return _step(np.sin(along * np.float32(rng.uniform(4, 14)) + np.float32(rng.uniform(0, 6))), 0.1)


def _sectors(rng: np.random.Generator, p: Float) -> Float:
    """Around a random axis, as on a beach ball."""
    a, b = _axis(rng), _axis(rng)
    return _step(np.sin(np.arctan2(a @ p, b @ p) * np.float32(rng.integers(1, 7))), 0.1)


def _checks(rng: np.random.Generator, p: Float) -> Float:
    """A chessboard on each side of a box; cubes cut by other surfaces."""
    cells = np.floor(p * np.float32(rng.uniform(2, 7)) + rng.uniform(0, 1, (3, 1)).astype(np.float32))
    flat: Float = cells[:2].sum(0) if rng.random() < 0.7 else cells.sum(0)
    parity: Float = (flat % 2).astype(np.float32)
    return parity


def _spots(rng: np.random.Generator, p: Float) -> Float:
    """Round patches."""
    share = np.zeros(p.shape[1], np.float32)
    for _ in range(int(rng.integers(1, 9))):
        away = p - _axis(rng)[:, None]
        share = np.maximum(share, _step(np.float32(rng.uniform(0.1, 0.5)) - np.sqrt((away * away).sum(0))))
    return share


def _sign(rng: np.random.Generator, p: Float) -> Float:
    """A letter, a number, a cross or a ring, painted from one side."""
    sheet = np.zeros((SIDE, SIDE), np.uint8)
    thick = int(rng.integers(6, 30))
    if rng.random() < 0.3:
        cv2.circle(sheet, (128, 128), int(rng.integers(30, 80)), 255, thick, cv2.LINE_AA)
    if rng.random() < 0.3:
        cv2.line(sheet, (40, 128), (216, 128), 255, thick)
        cv2.line(sheet, (128, 40), (128, 216), 255, thick)
    letter = "ABDEHKRSTX0123456789"[int(rng.integers(20))]
    cv2.putText(sheet, letter, (60, 190), cv2.FONT_HERSHEY_SIMPLEX, 6, 255, thick, cv2.LINE_AA)
    side = _axis(rng)
    up = np.cross(side, _axis(rng))
    up = (up / (np.linalg.norm(up) + 1e-6)).astype(np.float32)
    x = (side @ p + 1) * np.float32(SIDE / 2)
    y = (up @ p + 1) * np.float32(SIDE / 2)
    inside = (x > 0) & (x < SIDE) & (y > 0) & (y < SIDE) & (np.cross(side, up).astype(np.float32) @ p > 0)
    seen: Float = _look_up(sheet.astype(np.float32) / np.float32(255), x, y) * inside
    return seen
