"""Single pictures with balls and buoys of every look, for training and testing a detector.

Quick and various rather than exact: flat cameras, no refraction. Water, textures and sensor are the dive simulator's.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from leadline.samples import Image
from leadline.simulation import textures
from leadline.simulation.backdrops import random_backdrop
from leadline.simulation.canvas import Box, Canvas
from leadline.simulation.clutter import add_clutter
from leadline.simulation.optics import Float, WaterOptics, develop, f32, random_water
from leadline.simulation.props import add_solids
from leadline.simulation.skins import PAINTS_BGR

LABEL = "ball"
SOLID_PART = 0.65  # of the pictures have solids in perspective, with shadows; the others flat painted balls


def random_picture(rng: np.random.Generator, size: tuple[int, int] = (416, 416)) -> tuple[Image, list[Box], list[str]]:
    """One picture (h, w, 3) uint8 BGR, the visible balls' boxes (x, y, w, h) in pixels, and their labels.

    ``size`` is (height, width). A box is the outline of what is inside the picture of a ball of at least 8 px.
    """
    water = random_water(rng)
    canvas = Canvas(*random_backdrop(rng, size), np.full(size, -1, np.int16))
    add_clutter(rng, canvas.paint, size)
    add = add_solids if rng.random() < SOLID_PART else _add_balls
    outlines = add(rng, canvas, water)
    light = _illuminate(rng, canvas, water)
    image = _through_the_camera(rng, light)
    kept = [i for i, box in enumerate(outlines) if _visible(canvas.owner == i, image, box)]
    return image, [outlines[i] for i in kept], [LABEL] * len(kept)


def _add_balls(rng: np.random.Generator, canvas: Canvas, water: WaterOptics) -> list[Box]:
    """Paint none to four balls, the far ones first; each one's box within the picture."""
    count = int(rng.choice([0, 1, 2, 3, 4], p=[0.12, 0.56, 0.18, 0.09, 0.05]))
    height, width = canvas.distance_m.shape
    far = min(8.0, 2.2 / min(water.c))  # beyond, nothing is left of it to see
    boxes = []
    largest = 1.3 * max(height, width) if count == 1 else 0.35 * min(height, width)
    radii = sorted(np.exp(rng.uniform(np.log(9), np.log(largest), count)))
    for i, radius in enumerate(radii):
        reach = np.array([width, height]) + 1.2 * radius
        centre = rng.uniform(0, 1, 2) * reach - 0.6 * radius
        distance = min(far, 0.17 * 1.1 * width / radius * rng.uniform(0.6, 1.4))
        boxes.append(_paint_ball(rng, canvas, i, centre=centre, radius=float(radius), distance=float(distance)))
    return boxes


def _paint_ball(
    rng: np.random.Generator,
    canvas: Canvas,
    number: int,
    *,
    centre: NDArray[np.float64],
    radius: float,
    distance: float,
) -> Box:
    height, width = canvas.distance_m.shape
    squash = np.array([1.0, rng.uniform(0.94, 1.06)])
    pear = rng.uniform(0.15, 0.4) if rng.random() < 0.3 and radius < 0.3 * height else 0.0
    reach = radius * squash
    low, high = centre - reach - 1, centre + reach * np.array([1, 1 + pear]) + 2
    x0, y0 = np.clip(np.floor(low), 0, [width, height]).astype(int)
    x1, y1 = np.clip(np.ceil(high), 0, [width, height]).astype(int)
    if rng.random() < 0.35:
        _paint_tether(rng, canvas, centre, reach, distance)
    if x1 <= x0 or y1 <= y0:
        return 0.0, 0.0, 0.0, 0.0
    u: Float = ((np.arange(x0, x1) - centre[0]) / reach[0]).astype(np.float32)[None, :]
    v: Float = ((np.arange(y0, y1) - centre[1]) / reach[1]).astype(np.float32)[:, None]
    alpha, depth = _outline(u, v, radius, pear)
    colour = _skin(rng, u, v, depth, radius)
    shade = _shade(rng, u, v, depth)
    at = (slice(y0, y1), slice(x0, x1))
    canvas.paint(at, colour, alpha, np.full_like(alpha, distance), shade)
    canvas.owner[at][alpha > 0.5] = number
    left, top = max(low[0] + 1, 0.0), max(low[1] + 1, 0.0)
    right, bottom = min(centre[0] + reach[0], width), min(centre[1] + reach[1] * (1 + pear), height)
    return float(left), float(top), float(right - left), float(bottom - top)


def _outline(u: Float, v: Float, radius: float, pear: float) -> tuple[Float, Float]:
    """Coverage (h, w) of a ball, or of a pear-shaped buoy that tapers to its eye below; and the front's depth 0..1."""
    narrow: Float = v
    across: Float = u
    if pear:
        below = np.clip((v - np.float32(0.3)) / np.float32(0.7 + pear), 0, 1)
        narrow = v - np.float32(pear) * below
        across = u * (1 + np.float32(0.9 * pear) * below * below)
    squared: Float = across * across + narrow * narrow
    alpha: Float = np.clip((1 - np.sqrt(squared)) * np.float32(radius) + np.float32(0.5), 0, 1)
    return alpha, np.sqrt(np.maximum(1 - squared, 0))


def _skin(rng: np.random.Generator, u: Float, v: Float, depth: Float, radius: float) -> Float:
    """Paint on the ball: (h, w, 3), from one even colour to stains, bands, sectors and growth."""
    paint = np.array(PAINTS_BGR[int(rng.integers(len(PAINTS_BGR)))], np.float32)
    paint = np.clip(paint * rng.uniform(0.6, 1.25) + rng.normal(0, 0.03, 3), 0.02, 0.9).astype(np.float32)
    contrast = float(rng.choice([0.0, 0.3, 0.7, 1.2], p=[0.2, 0.35, 0.3, 0.15]))
    size = 256 if radius > 64 else 128
    chart = textures.worn_paint(rng, size, paint, contrast, octaves=6)
    turn = rng.uniform(0, 2 * np.pi)
    cos, sin = np.float32(np.cos(turn)), np.float32(np.sin(turn))
    a, b = cos * u + sin * v, cos * v - sin * u
    stretch = np.float32(size * rng.uniform(0.25, 0.45)) * np.sqrt(2 / (1 + depth))  # equal-area chart of the front
    middle = np.float32(size / 2)
    colour = textures.look_up(chart, a * stretch + middle, b * stretch + middle)
    if rng.random() < 0.15:  # a band or sectors of another colour
        other = np.array(PAINTS_BGR[int(rng.integers(len(PAINTS_BGR)))], np.float32)
        band = np.abs(b - rng.uniform(-0.4, 0.4)) < rng.uniform(0.05, 0.3) if rng.random() < 0.6 else a * b > 0
        colour[band] = colour[band] * np.float32(0.2) + other * np.float32(0.8)
    return colour


def _shade(rng: np.random.Generator, u: Float, v: Float, depth: Float) -> Float:
    """Light on the ball: from above, from the lamps beside the camera, and a gloss."""
    ambient, lamp = rng.uniform(0.2, 0.9), rng.uniform(0.0, 0.9)
    side = np.float32(rng.uniform(-0.5, 0.5))
    from_above = np.float32(0.55) - np.float32(0.45) * v
    from_camera = np.clip(depth * np.float32(0.9) + side * u, 0, 1)
    shade = np.float32(0.1 + ambient) * from_above + np.float32(lamp) * from_camera
    if rng.random() < 0.4:
        x, y, sharp = rng.uniform(-0.5, 0.5), rng.uniform(-0.6, 0.1), rng.uniform(20, 150)
        gloss = np.exp(np.float32(-sharp) * ((u - np.float32(x)) ** 2 + (v - np.float32(y)) ** 2))
        shade = shade + np.float32(rng.uniform(0.2, 1.5)) * gloss
    result: Float = np.maximum(shade, np.float32(0.05)).astype(np.float32)
    return result


def _paint_tether(
    rng: np.random.Generator, canvas: Canvas, centre: NDArray[np.float64], reach: NDArray[np.float64], distance: float
) -> None:
    """A rope or pole from the ball down (or up)."""
    height, width = canvas.distance_m.shape
    end_y = height + 5 if rng.random() < 0.8 else -5
    ends = np.array([centre, [centre[0] + rng.normal(0, 0.15) * abs(end_y - centre[1]), end_y]])
    mask = np.zeros((height, width), np.uint8)
    thick = max(1, round(reach[0] * rng.uniform(0.02, 0.12)))
    cv2.polylines(mask, [np.round(ends * 16).astype(np.int32)], False, 255, thick, cv2.LINE_AA, 4)
    x, y, w, h = cv2.boundingRect(mask)
    at = (slice(y, y + h), slice(x, x + w))
    alpha = mask[at].astype(np.float32) / np.float32(255)
    colour = np.full(3, rng.uniform(0.03, 0.6), np.float32)
    canvas.paint(at, colour, alpha, f32([[distance]]), f32([[0.5]]))


def _illuminate(rng: np.random.Generator, canvas: Canvas, water: WaterOptics) -> Float:
    """The light that reaches the lens: (h, w, 3)."""
    height, width = canvas.distance_m.shape
    light = canvas.shading
    if rng.random() < 0.4:
        pattern = textures.caustic(rng, 256)
        scale = width / 256 * rng.uniform(0.5, 2)
        pattern = f32(cv2.resize(pattern, None, fx=scale, fy=scale * rng.uniform(0.4, 1.0)))
        pattern = np.tile(pattern, (height // len(pattern) + 1, width // len(pattern[0]) + 1))[:height, :width]
        light = light * (np.float32(1) + np.float32(rng.uniform(0.05, 0.4)) * (pattern - np.float32(1)))
    direct = canvas.reflectance * light[..., None] * water.transmission(canvas.distance_m)
    glow = np.float32(1) - np.exp(np.float32(-water.forward) * canvas.distance_m)
    small = cv2.resize(direct, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    halo = cv2.resize(cv2.GaussianBlur(small, (0, 0), 3), (width, height))
    direct += (halo - direct) * glow[..., None]
    veil = water.veil(canvas.distance_m)
    veil *= _veil_shape(rng, height, width)[..., None]
    direct += veil
    _add_snow(rng, direct, water)
    if rng.random() < 0.2:
        _add_bubbles(rng, direct)
    if rng.random() < 0.25:
        _add_spot(rng, direct, canvas)
    return direct


def _veil_shape(rng: np.random.Generator, height: int, width: int) -> Float:
    """The backscatter is brighter towards the surface and in the lamps' beams."""
    y = np.linspace(-1, 1, height, dtype=np.float32)[:, None]
    x = np.linspace(-1, 1, width, dtype=np.float32)[None, :]
    shape = np.float32(1) - np.float32(rng.uniform(-0.1, 0.5)) * y
    if rng.random() < 0.3:
        cx, cy = rng.uniform(-1.2, 1.2), rng.uniform(-0.2, 1.2)
        shape = shape + np.float32(rng.uniform(0.2, 1)) * np.exp(
            -((x - np.float32(cx)) ** 2 + (y - np.float32(cy)) ** 2)
        )
    result: Float = np.broadcast_to(shape, (height, width)).astype(np.float32)
    return result


def _add_snow(rng: np.random.Generator, light: Float, water: WaterOptics) -> None:
    height, width = light.shape[:2]
    count = int(rng.poisson(min(200.0, water.snow_per_m3 * 0.4)))
    for x, y, radius, bright in zip(
        rng.uniform(0, width, count),
        rng.uniform(0, height, count),
        np.exp(rng.normal(-0.6, 0.5, count)),
        np.exp(rng.normal(-2.3, 0.8, count)),
        strict=True,
    ):
        _add_blob(light, x, y, float(radius), np.full(3, min(bright, 0.6), np.float32))


def _add_bubbles(rng: np.random.Generator, light: Float) -> None:
    """A stream of rising bubbles: bright rims with a glint, no balls."""
    height, width = light.shape[:2]
    rims = np.zeros((height, width), np.uint8)
    middle, spread = rng.uniform(0, width), rng.uniform(0.01, 0.3) * width
    for _ in range(int(rng.integers(3, 40))):
        at = (round(middle + spread * rng.standard_normal()), int(rng.uniform(0, height)))
        radius = int(np.exp(rng.uniform(0.5, 2.4)))
        cv2.ellipse(rims, at, (radius, max(1, int(radius * rng.uniform(0.5, 1)))), 0, 0, 360,
                    int(rng.integers(60, 256)), max(1, radius // 5), cv2.LINE_AA)  # fmt: skip
        cv2.circle(rims, (at[0] - radius // 3, at[1] - radius // 3), max(1, radius // 5), 255, -1, cv2.LINE_AA)
    light += (rims.astype(np.float32) * np.float32(rng.uniform(0.2, 1.0) / 255))[..., None]


def _add_spot(rng: np.random.Generator, light: Float, canvas: Canvas) -> None:
    """A laser's green spot, or a lamp's reflection."""
    height, width = canvas.distance_m.shape
    x, y = rng.uniform(0, width), rng.uniform(0, height)
    if rng.random() < 0.7:
        bright = np.array([0.25, 2.0, 0.5]) * rng.uniform(0.3, 3)
        _add_blob(light, x, y, rng.uniform(1, 5), bright.astype(np.float32))
    else:
        _add_blob(light, x, y, rng.uniform(5, 40), np.full(3, rng.uniform(0.3, 1.5), np.float32))


def _add_blob(light: Float, x: float, y: float, sigma: float, colour: Float) -> None:
    """Add a Gaussian blob in place."""
    height, width = light.shape[:2]
    r = int(3 * sigma) + 1
    x0, x1, y0, y1 = max(0, int(x) - r), min(width, int(x) + r + 2), max(0, int(y) - r), min(height, int(y) + r + 2)
    gx = np.exp(-0.5 * ((np.arange(x0, x1) - x) / sigma) ** 2)
    gy = np.exp(-0.5 * ((np.arange(y0, y1) - y) / sigma) ** 2)
    light[y0:y1, x0:x1] += np.outer(gy, gx).astype(np.float32)[..., None] * colour


def _through_the_camera(rng: np.random.Generator, light: Float) -> Image:
    """Blur, exposure, white balance, noise, JPEG."""
    if rng.random() < 0.6:
        light = f32(cv2.GaussianBlur(light, (0, 0), rng.uniform(0.3, 2.2)))
    if rng.random() < 0.2:
        angle, length = rng.uniform(0, np.pi), rng.uniform(2, 8)
        light = _smear(light, np.cos(angle) * length, np.sin(angle) * length)
    balance = np.exp(rng.normal(0, 0.12, 3)).astype(np.float32)
    level = float(np.percentile(light[::4, ::4], 97))
    light = light * balance * np.float32(float(np.exp(rng.uniform(-1.8, 0.0))) / max(level, 1e-3))
    light += np.float32(max(0.0, rng.normal(0, 0.02)))
    gain = rng.uniform(0.2, 1.5)
    image = develop(light, rng, 4e-4 * gain, 0.004 * gain)
    if rng.random() < 0.5:
        _, packed = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(40, 96))])
        image = np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR), np.uint8)
    return image


def _smear(light: Float, dx: float, dy: float) -> Float:
    """Average along a motion of (dx, dy) pixels."""
    height, width = light.shape[:2]
    total = np.zeros_like(light)
    for t in (-0.4, -0.2, 0.0, 0.2, 0.4):
        shift = np.array([[1, 0, t * dx], [0, 1, t * dy]])
        total += cv2.warpAffine(light, shift, (width, height), borderMode=cv2.BORDER_REPLICATE)
    result: Float = total * np.float32(0.2)
    return result


def _visible(mine: NDArray[np.bool_], image: Image, box: Box) -> bool:
    """It is 8 px in size, a third of the box is the ball, and it stands out from what is around it."""
    x, y, w, h = box
    if min(w, h) < 8 or np.count_nonzero(mine) < 0.3 * w * h:
        return False
    margin = 3 + 0.25 * max(w, h)
    x0, y0 = max(0, int(x - margin)), max(0, int(y - margin))
    window = (slice(y0, int(y + h + margin)), slice(x0, int(x + w + margin)))
    inside, near = mine[window], image[window].astype(np.float32)
    if inside.all():
        return True
    inner, outer = near[inside], near[~inside]
    contrast = float(np.abs(inner.mean(0) - outer.mean(0)).max())
    return contrast + 0.3 * float(np.abs(inner.std(0) - outer.std(0)).max()) > 10
