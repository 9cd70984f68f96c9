"""What a spot looks like, and one step of least squares towards it.

A Gaussian on a sloping ground, and behind it the glow of its own beam in the water, which ends at the spot: the spot's
light smeared back along the beam's image. In units in which the expected spot is the unit circle.

Everything but the exponentials is a polynomial of second order over the pixels, so that all derivatives are one
product of a small matrix with the pixels' monomials.
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


def monomials(u: Array) -> Array:
    """1, x, y, x^2, xy, y^2 (6, ...) of places u (2, ...)."""
    basis = np.empty((6, *u.shape[1:]))
    basis[0], basis[1:3] = 1.0, u
    np.multiply(u, u[0], out=basis[3:5])
    np.multiply(u[1], u[1], out=basis[5])
    return basis


def distance2(basis: Array, x: float, y: float) -> Array:
    """Square distances (n,) of the places from one."""
    return np.asarray(np.array([x * x + y * y, -2 * x, -2 * y, 1.0, 0.0, 1.0]) @ basis)


def solved(a: Array, b: Array) -> Array:
    """The solution (n,) or (n, k) of a x = b; OpenCV's takes a third of NumPy's time for matrices this small."""
    return np.asarray(cv2.solve(a, b.reshape(len(b), -1))[1], np.float64).reshape(b.shape)


@dataclass(frozen=True, slots=True)
class Normal:
    """The normal equations at theta (m,)."""

    theta: Array
    matrix: Array  # (m, m)
    pull: Array  # (m,)
    chi2: float
    dof: int
    beam: Beamed | None

    @classmethod
    def start(cls, basis: Array, rows: Array, beam: Beamed | None) -> Normal:
        """With the expected place and form. basis: ``monomials`` (6, n). rows: (m + 1, n), of which the last are the
        values and all others are filled here and in ``at``."""
        count = len(rows) - 1
        rows[GROUND] = basis[:3]
        theta = np.zeros(count)
        theta[HEIGHT] = 1.0
        _evaluate(theta, basis, rows, beam)
        gram = rows @ rows.T
        theta[HEIGHT:GLOW] = solved(gram[HEIGHT:GLOW, HEIGHT:GLOW], gram[HEIGHT:GLOW, count])
        height = float(theta[HEIGHT])
        rows[:HEIGHT] *= height
        gram[:HEIGHT] *= height
        gram[:, :HEIGHT] *= height
        return cls._of(theta, gram, rows, beam)

    @classmethod
    def at(cls, theta: Array, basis: Array, rows: Array, beam: Beamed | None) -> Normal:
        _evaluate(theta, basis, rows, beam)
        return cls._of(theta, rows @ rows.T, rows, beam)

    @classmethod
    def _of(cls, theta: Array, gram: Array, rows: Array, beam: Beamed | None) -> Normal:
        """gram: (m + 1, m + 1), of d(model)/d(parameter) and the values."""
        count = len(theta)
        left = gram[:, count] - gram[:, HEIGHT:count] @ theta[HEIGHT:]
        chi2 = float(left[count] - theta[HEIGHT:] @ left[HEIGHT:count])
        gram.ravel()[:: count + 2] += 1e-9
        return cls(theta, gram[:count, :count], left[:count], chi2, max(rows.shape[1] - count, 5), beam)

    @property
    def variance(self) -> float:
        return self.chi2 / self.dof + 1e-3

    def residual(self, rows: Array) -> Array:
        """(n,) of the values in ``rows``."""
        return np.asarray(rows[-1] - self.theta[HEIGHT:] @ rows[HEIGHT:-1])

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

    def rms(self, step: Array | None = None) -> float:
        """Of the residual, here or after a step so small that the model is linear."""
        less = 0.0 if step is None else float(step @ (2 * self.pull - self.matrix @ step))
        return float((max(self.chi2 - less, 0.0) / self.dof + 1e-3) ** 0.5)


def _evaluate(theta: Array, basis: Array, rows: Array, beam: Beamed | None) -> None:
    """The model's derivatives by its parameters, in place; rows[5] is the Gaussian itself, rows[9] the beam's light."""
    x, y, size, stretch, skew, height = theta[:6].tolist()
    a, b, c = 1 + size + stretch, skew, 1 + size - stretch  # the form; times off = (place - centre) it is (f, g)
    f, g, half = -a * x - b * y, -b * x - c * y, -0.5 * height
    polynomials = [
        [height * f, height * a, height * b, 0.0, 0.0, 0.0],
        [height * g, height * b, height * c, 0.0, 0.0, 0.0],
        [half * (x * x + y * y), height * x, height * y, half, 0.0, half],
        [half * (x * x - y * y), height * x, -height * y, half, 0.0, -half],
        [-height * x * y, height * y, height * x, 0.0, -height, 0.0],
        [0.5 * (x * f + y * g), -f, -g, -0.5 * a, -b, -0.5 * c],  # the exponent, -off.(f, g) / 2
    ]
    if beam is not None:
        _add_glow(polynomials, (x, y), (a, b, c), float(theta[GLOW]), beam.back)
    over = np.array(polynomials) @ basis
    light = np.exp(over[5], out=rows[HEIGHT])
    np.multiply(over[:5], light, out=rows[:5])
    if beam is not None:
        glow = np.multiply(np.exp(np.minimum(over[6], 0)), ndtr(over[7]), out=rows[GLOW])
        rows[:2] += over[8:10] * glow


def _add_glow(
    polynomials: list[list[float]],
    centre: tuple[float, float],
    form: tuple[float, float, float],
    level: float,
    back: tuple[float, float],
) -> None:
    """The glow: its exponent across the beam, the way along it in sigmas towards the laser, and its derivatives by the
    centre, the end's at once among the spot's own (those by the form are left out)."""
    (x, y), (a, b, c), (p, q) = centre, form, back
    s, t = a * p + b * q, b * p + c * q
    scale = max(p * s + q * t, 0.05) ** 0.5
    s, t = s / scale, t / scale
    o = -s * x - t * y
    e = polynomials[5]
    way = [o, s, t, 0.0, 0.0, 0.0]
    squared = [o * o, 2 * o * s, 2 * o * t, s * s, 2 * s * t, t * t]
    polynomials += [
        [i + 0.5 * j for i, j in zip(e, squared, strict=True)],
        way,
        [level * (-e[1] - s * o), level * (a - s * s), level * (b - s * t), 0.0, 0.0, 0.0],
        [level * (-e[2] - t * o), level * (b - s * t), level * (c - t * t), 0.0, 0.0, 0.0],
    ]
    polynomials[0][0] -= level * _GAUSS * s
    polynomials[1][0] -= level * _GAUSS * t
