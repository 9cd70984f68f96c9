"""Solids before a pinhole camera, traced along their distance functions.

A solid's ``distance`` takes points (3, n) in its own units and gives how far each is from the surface, negative inside
(https://iquilezles.org/articles/distfunctions). The camera stands at the origin and looks along +z.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leadline.simulation.optics import Float

Distance = Callable[[Float], Float]
Vector = NDArray[np.float64]
STEPS = 36


@dataclass(frozen=True, slots=True)
class Solid:
    """A shape around its own origin; nothing of it is further than ``reach`` from there."""

    distance: Distance
    reach: float


@dataclass(frozen=True, slots=True)
class Placed:
    """A solid in the scene: its own point is turn.T @ (point - centre_m) / scale_m."""

    solid: Solid
    centre_m: Vector  # (3,)
    turn: Vector  # (3, 3)
    scale_m: float

    @property
    def reach_m(self) -> float:
        return self.solid.reach * self.scale_m


@dataclass(frozen=True, slots=True)
class Seen:
    """What the rays (n,) met: length, coverage 0..1, unit normals (3, n) and own points (3, n)."""

    length_m: Float
    alpha: Float
    normal: Float
    point: Float


def sphere() -> Solid:
    def distance(p: Float) -> Float:
        gap: Float = np.sqrt((p * p).sum(0)) - np.float32(1)
        return gap

    return Solid(distance, 1.0)


def box(half: Vector) -> Solid:
    """``half``: (3,) half edges."""
    corner = half.astype(np.float32)[:, None]

    def distance(p: Float) -> Float:
        q = np.abs(p) - corner
        gap: Float = np.sqrt((np.maximum(q, 0) ** 2).sum(0)) + np.minimum(q.max(0), 0)
        return gap

    return Solid(distance, float(np.linalg.norm(half)))


def cylinder(radius: float, half_height: float, bore: float = 0.0) -> Solid:
    """Around y; ``bore``: radius of the hole through it, a tube or a washer."""

    def distance(p: Float) -> Float:
        across = np.sqrt(p[0] ** 2 + p[2] ** 2)
        side = across - np.float32(radius)
        if bore:
            side = np.maximum(side, np.float32(bore) - across)
        end = np.abs(p[1]) - np.float32(half_height)
        inside = np.minimum(np.maximum(side, end), 0)
        gap: Float = np.sqrt(np.maximum(side, 0) ** 2 + np.maximum(end, 0) ** 2) + inside
        return gap

    return Solid(distance, float(np.hypot(radius, half_height)))


def cone(radius: float, height: float) -> Solid:
    """Around y, its tip at +height / 2."""
    slope = radius / height
    fall = np.float32(1 / np.hypot(1, slope))

    def distance(p: Float) -> Float:
        across = np.sqrt(p[0] ** 2 + p[2] ** 2)
        side = (across - np.float32(slope) * (np.float32(height / 2) - p[1])) * fall
        gap: Float = np.maximum(side, np.abs(p[1]) - np.float32(height / 2))
        return gap

    return Solid(distance, float(np.hypot(radius, height / 2)))


def torus(radius: float, thickness: float) -> Solid:
    """Around y; ``thickness`` the tube's radius."""

    def distance(p: Float) -> Float:
        across = np.sqrt(p[0] ** 2 + p[2] ** 2) - np.float32(radius)
        gap: Float = np.sqrt(across**2 + p[1] ** 2) - np.float32(thickness)
        return gap

    return Solid(distance, radius + thickness)


def rock(rng: np.random.Generator) -> Solid:
    """A lump with facets and waves, of uneven axes: nowhere near a ball."""
    axes = np.array([1.0, rng.uniform(0.35, 0.65), rng.uniform(0.5, 1.0)], np.float32)[:, None]
    waves = rng.normal(0, 1, (5, 3)).astype(np.float32) * np.float32(3)
    phases = rng.uniform(0, 6.3, 5).astype(np.float32)
    rough = np.float32(rng.uniform(0.05, 0.13))
    planes = rng.normal(0, 1, (5, 3))
    faces = (planes / np.linalg.norm(planes, axis=1, keepdims=True)).astype(np.float32)
    cuts = rng.uniform(0.35, 0.7, 5).astype(np.float32)[:, None]

    def distance(p: Float) -> Float:
        q = p / axes
        lump = np.sqrt((q * q).sum(0)) - np.float32(1)
        lump = np.maximum(lump, (faces @ q - cuts).max(0))
        lump += rough * np.sin(waves @ p + phases[:, None]).sum(0)
        gap: Float = lump * np.float32(0.4)  # what is stretched and wavy is no true distance: shorter steps
        return gap

    return Solid(distance, 1.6)


def see(placed: Placed, rays: Float, pixel_rad: float) -> Seen:
    """Follow unit rays (3, n) from the camera to the solid's surface, in the solid's own units."""
    turn, scale, reach = placed.turn.astype(np.float32), np.float32(placed.scale_m), np.float32(placed.solid.reach)
    eye = -(placed.turn.T @ placed.centre_m / placed.scale_m).astype(np.float32)[:, None]
    own = turn.T @ rays
    along = -(own * eye).sum(0)
    near = np.flatnonzero((eye * eye).sum() - along**2 < (reach * np.float32(1.02)) ** 2)
    alpha, length = np.zeros_like(along), along.copy()
    ray = own[:, near]
    alpha[near], length[near] = _follow(placed.solid, eye, ray, along[near], np.float32(pixel_rad))
    point = eye + own[:, near] * length[near]
    normal, points = np.zeros_like(own), np.zeros_like(own)
    points[:, near], normal[:, near] = point, turn @ _slope(placed.solid.distance, point)
    return Seen(length * scale, alpha, normal, points)


def _follow(solid: Solid, eye: Float, ray: Float, middle: Float, pixel_rad: np.float32) -> tuple[Float, Float]:
    """Coverage and length of rays that come near the solid: the place where each comes nearest to the surface."""
    reach = np.float32(solid.reach)
    length = np.maximum(middle - reach, np.float32(0.01))
    nearest, place = np.full_like(length, np.inf), length.copy()
    moving = np.arange(len(length))
    for _ in range(STEPS):
        at = length[moving]
        gap = solid.distance(eye + ray[:, moving] * at)
        closer = gap < nearest[moving]
        nearest[moving[closer]], place[moving[closer]] = gap[closer], at[closer]
        length[moving] = at + gap
        moving = moving[(gap > 0.1 * pixel_rad * at) & (at < middle[moving] + reach)]
        if not len(moving):
            break
    alpha: Float = np.clip(np.float32(1.1) - nearest / (pixel_rad * place), 0, 1)
    return alpha, place


def _slope(distance: Distance, point: Float) -> Float:
    """(3, n) unit gradient of the distance, by four differences (a tetrahedron's corners)."""
    step = np.float32(2e-3)
    total = np.zeros_like(point)
    for corner in ((1, -1, -1), (-1, -1, 1), (-1, 1, -1), (1, 1, 1)):
        arm = np.array(corner, np.float32)[:, None]
        total += arm * distance(point + arm * step)
    norm: Float = total / (np.sqrt((total * total).sum(0)) + np.float32(1e-9))
    return norm


def random_turn(rng: np.random.Generator) -> Vector:
    """(3, 3) a rotation, all equally likely."""
    q, r = np.linalg.qr(rng.normal(0, 1, (3, 3)))
    turn: Vector = q * np.sign(np.diag(r))
    turn[:, 0] *= np.sign(np.linalg.det(turn))
    return turn


def random_distractor(rng: np.random.Generator) -> Solid:
    """Something that is no ball from any side: box, board, can, disc, tube, hoop, cone, rock."""
    bore = rng.uniform(0.3, 0.92)
    kinds: tuple[Callable[[], Solid], ...] = (
        lambda: box(rng.uniform(0.25, 1.0, 3)),
        lambda: box(np.array([1.0, rng.uniform(0.5, 1.0), 0.03])),
        lambda: cylinder(rng.uniform(0.25, 1.0), rng.uniform(0.4, 1.2)),
        lambda: cylinder(1.0, rng.uniform(0.02, 0.2)),
        lambda: cylinder(1.0, rng.uniform(0.05, 1.2), bore),
        lambda: torus(1.0, rng.uniform(0.06, 0.4)),
        lambda: cone(rng.uniform(0.4, 1.0), rng.uniform(0.8, 2.0)),
        lambda: rock(rng),
    )
    return kinds[int(rng.integers(len(kinds)))]()
