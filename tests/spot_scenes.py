"""Pictures of a laser's spot, made without anything of the finder: every ray through the port, met with the surface.

The truth is where the rig sees the point in which the beam's middle meets the surface. Light adds up in linear units,
the paint's blotches and grain multiply all of it, and the camera blurs, adds noise, cuts off and encodes.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from leadline.rig import Rig, Side
from leadline.samples import Array, Image
from leadline.target import Plane, Sphere, Target

HALF_PX, LIT_PX = 130, 60
FINE = 3  # rays a pixel, each way
SIGMA_M = 0.0015
GREEN = np.array([0.12, 1.0, 0.1])  # BGR, as the cameras see the laser
PAINT = np.array([0.055, 0.14, 0.32])  # an orange ball
GAMMA = 2.2


@dataclass(frozen=True)
class Look:
    """How a spot looks: its height over the ground in linear light, the noise, the surface."""

    power: float
    noise: float = 0.004
    blotches: float = 0.01
    tilt_deg: float = 10.0
    ball: bool = False
    lengths_m: tuple[float, float] = (0.5, 1.8)


LOOKS = {
    "bright": Look(0.5),
    "dim": Look(0.04),
    "saturated": Look(12.0, lengths_m=(0.4, 1.5)),
    "elongated": Look(0.5, tilt_deg=45.0, lengths_m=(0.4, 1.5)),
    "ball": Look(0.5, tilt_deg=45.0, ball=True, lengths_m=(0.4, 1.5)),
}


@dataclass(frozen=True)
class Shot:
    """A part of one camera's picture, whose first pixel is ``corner_px`` of the whole; the truth in its own pixels."""

    image: Image
    dark: Image
    corner_px: Array
    truth_px: Array
    side: Side
    length_m: float
    target: Target
    x: Array


def shoot(rig: Rig, look: Look, rng: np.random.Generator) -> Shot:
    """One draw: a length, a camera, a slant, a texture, a noise."""
    assert rig.laser is not None
    while True:
        length = float(1 / rng.uniform(1 / look.lengths_m[1], 1 / look.lengths_m[0]))
        side: Side = "left" if rng.random() < 0.5 else "right"
        spot = rig.laser.origin_m + length * rig.laser.direction
        whole_px = rig.project(spot[None])[side == "right"][0]
        if (whole_px > 30).all() and (whole_px < [rig.left.width - 30, rig.left.height - 30]).all():
            break
    normal = _tilted(-rig.laser.direction, look.tilt_deg, rng)
    target: Target = Sphere(0.34) if look.ball else Plane()
    x = spot - 0.17 * normal if look.ball else (spot @ normal) * normal
    corner = np.maximum(np.round(whole_px).astype(int) - HALF_PX, 0)
    size = np.minimum(np.array([rig.left.width, rig.left.height]) - corner, 2 * HALF_PX + 1)
    reach = min(LIT_PX, 10 + int(9 * SIGMA_M * rig.focal_outside_px / length))
    low = np.maximum(np.round(whole_px).astype(int) - reach, corner)
    lit = np.minimum(2 * reach + 1, corner + size - low)
    light = np.zeros((size[1], size[0]))
    at = np.s_[low[1] - corner[1] : low[1] - corner[1] + lit[1], low[0] - corner[0] : low[0] - corner[0] + lit[0]]
    light[at] = _spot_light(rig, side, low, lit, x if look.ball else None, spot, normal)
    paint = PAINT * _texture(rng, size, look.blotches)[..., None]
    seen = paint * (1 + look.power / PAINT[1] * light[..., None] * GREEN)
    return Shot(
        _encoded(seen, look.noise, rng),
        _encoded(paint, look.noise, rng),
        corner.astype(float),
        whole_px - corner,
        side,
        length,
        target,
        x,
    )


def _tilted(towards: Array, tilt_deg: float, rng: np.random.Generator) -> Array:
    """A unit normal at an angle to a direction, to a random side."""
    aside = np.cross(towards, rng.normal(size=3))
    aside /= np.linalg.norm(aside)
    angle = np.deg2rad(tilt_deg)
    return np.asarray(np.cos(angle) * towards + np.sin(angle) * aside)


def _spot_light(
    rig: Rig, side: Side, corner: Array, size: Array, centre: Array | None, spot: Array, normal: Array
) -> Array:
    """(h, w) the laser's light on the surface over its peak, each pixel the mean of its rays, blurred by the lens."""
    assert rig.laser is not None
    u = corner[0] - 0.5 + (np.arange(size[0] * FINE) + 0.5) / FINE
    v = corner[1] - 0.5 + (np.arange(size[1] * FINE) + 0.5) / FINE
    coarse = np.stack(np.meshgrid(u[::8], v[::8]), axis=-1)
    origins, directions = rig.rays(coarse.reshape(-1, 2), side)
    shape = (len(v[::8]), len(u[::8]), 3)
    place = np.arange(len(u)) / 8, np.arange(len(v)) / 8
    x, y = np.meshgrid(*place)
    o, d = (
        np.stack([_between(field.reshape(shape)[..., i], x, y) for i in range(3)], axis=-1)
        for field in (origins, directions)
    )
    if centre is None:
        way = ((spot - o) @ normal) / (d @ normal)
        points, facing = o + way[..., None] * d, np.full(way.shape, 1.0)
    else:
        to = centre - o
        along = np.einsum("hwi,hwi->hw", to, d) / np.einsum("hwi,hwi->hw", d, d)
        d2 = np.einsum("hwi,hwi->hw", d, d)
        inside = 0.17**2 - np.einsum("hwi,hwi->hw", to, to) + along**2 * d2
        way = along - np.sqrt(np.maximum(inside, 0) / d2)
        points = o + way[..., None] * d
        facing = np.maximum((points - centre) / 0.17 @ -rig.laser.direction, 0) / (normal @ -rig.laser.direction)
        facing = np.where(inside > 0, facing, 0.0)
    off = points - rig.laser.origin_m
    off -= (off @ rig.laser.direction)[..., None] * rig.laser.direction
    profile = np.exp(-0.5 * np.einsum("hwi,hwi->hw", off, off) / SIGMA_M**2) * facing
    lit = profile.reshape(size[1], FINE, size[0], FINE).mean(axis=(1, 3))
    return np.asarray(cv2.GaussianBlur(lit, (0, 0), 0.6))


def _between(field: Array, x: Array, y: Array) -> Array:
    """A smooth field between its samples (linear is enough: rays turn by 1e-6 over two pixels); ends go on straight."""
    wide = np.pad(field, 1, mode="reflect", reflect_type="odd")
    x, y = x + 1, y + 1
    i, j = np.minimum(y.astype(int), wide.shape[0] - 2), np.minimum(x.astype(int), wide.shape[1] - 2)
    s, t = y - i, x - j
    return np.asarray(
        (1 - s) * ((1 - t) * wide[i, j] + t * wide[i, j + 1]) + s * ((1 - t) * wide[i + 1, j] + t * wide[i + 1, j + 1])
    )


def _texture(rng: np.random.Generator, size: Array, blotches: float) -> Array:
    """Reflectance about 1: blotches 8 px wide, and grain."""
    field = np.zeros((size[1], size[0]))
    for width, share in ((8.0, 1.0), (1.5, 0.4)):
        layer = cv2.GaussianBlur(rng.normal(0, 1, (size[1], size[0])), (0, 0), width)
        field += share * blotches * layer / layer.std()
    return 1 + field


def _encoded(light: Array, noise: float, rng: np.random.Generator) -> Image:
    sigma = np.sqrt(noise**2 + 2.5e-4 * np.maximum(light, 0) * (noise / 0.004) ** 2 * 0.3)
    taken = np.clip(light + rng.normal(0, 1, light.shape) * sigma, 0, 1)
    return np.round(255 * taken ** (1 / GAMMA)).astype(np.uint8)
