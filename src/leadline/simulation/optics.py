"""How water changes light (Jaffe 1990, McGlamery 1980), per colour channel.

seen = direct * exp(-c z) + forward-scattered part of the direct light, blurred + B (1 - exp(-k z))

Channels are in the order red, green, blue here; images are BGR, so the renderer turns the order round once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.floating[Any]]  # images and textures: always float32, which no stub can follow through every ufunc


@dataclass(frozen=True, slots=True)
class WaterOptics:
    """Water's parameters, by channel (red, green, blue).

    ``c`` attenuation (1/m), ``k`` backscatter build-up (1/m), ``B`` the veil's colour at infinity (linear light, 0..1);
    ``forward`` the forward scattering (1/m), ``snow_per_m3`` the number of visible particles.
    """

    c: tuple[float, float, float]
    B: tuple[float, float, float]
    k: tuple[float, float, float]
    forward: float
    snow_per_m3: float

    def transmission(self, distance_m: Float | float) -> Float:
        """exp(-c z): (..., 3) in BGR order."""
        return self._exponential(self.c, distance_m)

    def veil(self, distance_m: Float | float) -> Float:
        """B (1 - exp(-k z)): (..., 3) in BGR order."""
        gone = self._exponential(self.k, distance_m)
        if gone.ndim < 3:
            return bgr(self.B) * (np.float32(1.0) - gone)
        # B - B t for each channel, in one pass
        return f32(cv2.transform(gone, np.column_stack([np.diag(-bgr(self.B)), bgr(self.B)])))

    @staticmethod
    def _exponential(rate: tuple[float, float, float], distance_m: Float | float) -> Float:
        if np.ndim(distance_m) < 2:
            return np.exp(f32(distance_m)[..., None] * -bgr(rate))
        # Channel by channel: NumPy is slow where the innermost axis has but three elements.
        return f32(cv2.exp(cv2.merge([np.multiply(distance_m, np.float32(-r)) for r in rate[::-1]])))


def spread(values: Float) -> Float:
    """(h, w) to (h, w, 3): to multiply a picture by it, several times faster than by broadcasting."""
    return f32(cv2.merge([values, values, values]))


def f32(values: object) -> Float:
    """OpenCV's results and scalars as a float32 array."""
    array: Float = np.asarray(values, np.float32)
    return array


def bgr(rgb: tuple[float, float, float]) -> Float:
    return np.array(rgb[::-1], np.float32)


# Clear and turbid are the values of a published path-traced set's order of size; green is a lake or harbour in summer.
WATERS = {
    "clear": WaterOptics((0.35, 0.07, 0.05), (0.03, 0.13, 0.16), (0.35, 0.09, 0.08), 0.02, 15.0),
    "green": WaterOptics((0.60, 0.22, 0.38), (0.05, 0.20, 0.13), (0.60, 0.26, 0.40), 0.07, 120.0),
    "turbid": WaterOptics((1.10, 0.55, 0.80), (0.08, 0.24, 0.13), (1.10, 0.60, 0.85), 0.16, 500.0),
}


def random_water(rng: np.random.Generator) -> WaterOptics:
    """From swimming pool to soup: log-uniform turbidity, hue from blue through green to brown."""
    turbidity = float(np.exp(rng.uniform(np.log(0.05), np.log(1.3))))
    hue = rng.uniform(0, 1)  # 0 blue, 1 brown-green
    absorb = np.array([0.30, 0.05 + 0.03 * hue, 0.03 + 0.35 * hue]) * rng.uniform(0.7, 1.3, 3)
    scatter = turbidity * np.array([0.95, 0.9, 1.0])
    brown = max(0.0, hue - 0.75) * 4
    colour = np.array([0.02 + 0.06 * hue + 0.14 * brown, 0.12 + 0.12 * hue, 0.20 - 0.10 * hue - 0.04 * brown])
    colour *= rng.uniform(0.6, 1.6) * rng.uniform(0.85, 1.15, 3)
    c, k = scatter * 0.6 + absorb, scatter * 0.6 + absorb
    return WaterOptics(_rgb(c), _rgb(colour), _rgb(k), 0.15 * turbidity, 400.0 * turbidity)


def _rgb(values: NDArray[np.float64]) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])


def gamma_table(levels: int = 4096) -> NDArray[np.uint8]:
    """Linear light (0..levels-1) to 8-bit sRGB-like values: what a camera's picture holds."""
    linear = np.linspace(0, 1, levels)
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    table: NDArray[np.uint8] = np.round(255 * srgb).astype(np.uint8)
    return table


_GAMMA = gamma_table()


def develop(linear: Float, rng: np.random.Generator, shot: float, read: float) -> NDArray[np.uint8]:
    """Shot noise (variance ``shot`` * signal), read noise (standard deviation), saturation, gamma, 8 bits."""
    noise = rng.standard_normal(linear.shape, np.float32)
    sigma = np.maximum(linear, 0)
    sigma *= np.float32(shot)
    sigma += np.float32(read * read)
    noise *= np.sqrt(sigma, out=sigma)
    noise += linear
    noise *= np.float32(len(_GAMMA) - 1)
    noise += np.float32(0.5)
    level = np.clip(noise, 0, len(_GAMMA) - 1, out=noise)
    image: NDArray[np.uint8] = np.take(_GAMMA, level.astype(np.uint16))
    return image
