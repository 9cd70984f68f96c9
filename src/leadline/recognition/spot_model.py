"""What a spot looks like, and one step of least squares towards it.

A Gaussian on a sloping ground, and behind it the glow of its own beam in the water, which ends at the spot: the spot's
light smeared back along the beam's image. In units in which the expected spot is the unit circle.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot

import cv2
import numpy as np
from scipy.special import ndtr

from leadline.samples import Array

CENTRE, FORM, HEIGHT, GROUND, GLOW = slice(0, 2), slice(2, 5), 5, slice(6, 9), 9
"""theta: centre; size, stretch and skew of the light's inverse covariance; height; ground and its slopes; glow."""

LONGEST = np.array([0.7] * 5 + [np.inf] * 5)  # step, sigmas
BACKSCATTER_PER_M = 1.0  # the glow of a metre of beam in one line of sight against the spot: of the worst water
DARK = 0.03  # a beam that cannot glow more than this part of the spot pulls it by less than a hundredth of a sigma
_GAUSS = 0.3989422804  # 1 / sqrt(2 pi)


@dataclass(frozen=True, slots=True)
class Beamed:
    """The beam behind the spot. back: (2,) unit vector towards the laser; glow: how bright it may be, of the spot."""

    back: tuple[float, float]
    glow: float

    @classmethod
    def of(cls, along: Array) -> Beamed | None:
        """along: (2,) d(place)/d(length), sigmas of the spot per metre, away from the laser. None: it is dark."""
        x, y = along.tolist()
        per_m = hypot(x, y)
        glow = BACKSCATTER_PER_M / (_GAUSS * per_m)
        return cls((-x / per_m, -y / per_m), glow) if glow > DARK else None


def blank(u: Array, r2: Array, beam: Beamed | None) -> Array:
    """Terms (9 or 10, n) of the places u (2, n), filled as far as they never change."""
    terms = np.empty((9 if beam is None else 10, u.shape[1]))
    terms[HEIGHT], terms[6], terms[7:9] = np.exp(-0.5 * r2), 1.0, u
    return terms


def heights(values: Array, linear: Array) -> Array:
    """Height, ground and what else is linear (k,) of values (n,), or the heights (C,) of (n, C), for known places."""
    fitted = solved(linear @ linear.T, linear @ values)
    return fitted if values.ndim == 1 else np.asarray(fitted[0])


def solved(a: Array, b: Array) -> Array:
    """The solution (n,) or (n, k) of a x = b; OpenCV's takes a third of NumPy's time for matrices this small."""
    return np.asarray(cv2.solve(a, b.reshape(len(b), -1))[1], np.float64).reshape(b.shape)


@dataclass(frozen=True, slots=True)
class Normal:
    """The normal equations at theta (m,)."""

    theta: Array
    matrix: Array  # (m, m)
    pull: Array  # (m,)
    residual: Array  # (n,)
    variance: float
    beam: Beamed | None

    @classmethod
    def at(cls, theta: Array, u: Array, values: Array, terms: Array, beam: Beamed | None) -> Normal:
        """``terms``: of ``blank``; those that change are overwritten."""
        _evaluate(theta, u, terms, beam)
        residual = values - theta[HEIGHT:] @ terms[HEIGHT:]
        variance = float(residual @ residual) / max(len(values) - len(theta), 5) + 1e-3
        matrix = terms @ terms.T
        matrix.ravel()[:: len(theta) + 1] += 1e-9
        return cls(theta, matrix, terms @ residual, residual, variance, beam)

    def step(self, form_sigma: float) -> tuple[Array, Array]:
        """With the form held to what is expected by so much, the glow to what water can do; and the matrix for it."""
        count = len(self.theta)
        hold = np.zeros(count)
        hold[FORM] = self.variance / form_sigma**2
        if self.beam is not None:
            hold[GLOW] = self.variance / (self.beam.glow * max(float(self.theta[HEIGHT]), 1.0)) ** 2
        matrix = self.matrix.copy()
        matrix.ravel()[:: count + 1] += hold
        longest = LONGEST[:count]
        step = solved(matrix, self.pull - hold * self.theta)
        return np.minimum(np.maximum(step, -longest), longest), matrix


def _evaluate(theta: Array, u: Array, terms: Array, beam: Beamed | None) -> None:
    """The model's derivatives by its parameters, in place; terms[5] is the Gaussian itself."""
    cx, cy, size, stretch, skew, height = theta[:6].tolist()
    off = u - np.array([[cx], [cy]])
    form = np.array([[1 + size + stretch, skew], [skew, 1 + size - stretch]])
    by = form @ off
    both = off * by
    distance2 = both[0] + both[1]
    light = np.exp(-0.5 * distance2)
    np.multiply(by, height * light, out=terms[:2])
    half = (-0.5 * height * light) * off
    x2, y2 = half * off
    np.add(x2, y2, out=terms[2])
    np.subtract(x2, y2, out=terms[3])
    np.multiply(half[0], 2 * off[1], out=terms[4])
    terms[5] = light
    if beam is not None:
        _glow(float(theta[GLOW]), form, by, distance2, terms, beam)


def _glow(level: float, form: Array, by: Array, distance2: Array, terms: Array, beam: Beamed) -> None:
    """The beam's light, terms[9], and what it adds to the derivatives by the centre (by the form: left out)."""
    back = np.array(beam.back)
    towards = form @ back
    towards /= max(float(back @ towards), 0.05) ** 0.5
    way = back @ by / max(float(back @ form @ back), 0.05) ** 0.5  # sigmas from the spot towards the laser
    across = np.exp(-0.5 * np.maximum(distance2 - way * way, 0))
    np.multiply(across, ndtr(way), out=terms[GLOW])
    end = across * np.exp(-0.5 * way * way) * _GAUSS
    terms[:2] += level * (terms[GLOW] * (by - towards[:, None] * way) - towards[:, None] * end)
