"""Pinhole camera with OpenCV's distortion: 0, 4, 5, 8 or 12 coefficients (k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4]]]).

Pixel (0, 0) is the centre of the top-left pixel. Source of the model: OpenCV, "Camera Calibration and 3D
Reconstruction", detailed description.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import ArrayLike

from leadline.geometry.arrays import as_rows, chunks
from leadline.samples import Array

_COUNTS = (0, 4, 5, 8, 12)
_NEWTON_STEPS = 30
_LARGEST = float(np.finfo(np.float64).max)
_LAST_STEP = 1e-7  # of normalised coordinates: the next one is its square, 1e-11 px at a focal length of 1000 px


@dataclass(frozen=True, slots=True)
class Camera:
    """Focal lengths ``fx, fy`` and principal point ``cx, cy`` in pixels, image size in pixels, distortion coefficients.

    ValueError for a number that is not finite, a focal length or size that is not positive, or another count of
    coefficients.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    distortion: tuple[float, ...] = ()
    # Beyond this squared radius the distortion curve turns back and a far-off point would appear inside the image.
    fold_r2: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        coefficients = tuple(float(k) for k in np.ravel(np.asarray(self.distortion, dtype=np.float64)))
        if len(coefficients) not in _COUNTS:
            raise ValueError(f"distortion: must have 0, 4, 5, 8 or 12 coefficients, not {len(coefficients)}")
        for name, value in [
            *((f.name, getattr(self, f.name)) for f in fields(self)[:6]),
            ("distortion", sum(coefficients)),
        ]:
            if not abs(value) <= _LARGEST:  # nor NaN, nor a whole number beyond all floats
                raise ValueError(f"{name}: must be finite")
            if name in ("fx", "fy", "width", "height") and value <= 0:
                raise ValueError(f"{name}: must be positive")
        object.__setattr__(self, "distortion", coefficients if any(coefficients) else ())
        object.__setattr__(self, "fold_r2", _fold_r2(self._twelve()) if self.distortion else np.inf)

    @property
    def matrix(self) -> Array:
        """K (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, points_m: ArrayLike) -> Array:
        """Points (N, 3) of the camera's frame, no port -> pixels (N, 2); NaN behind the camera or beyond the fold."""
        points = as_rows(points_m, 3)
        pixels = np.empty((len(points), 2))
        with np.errstate(invalid="ignore", over="ignore"):
            for part in chunks(len(points)):
                x, y, z = points[part].T.copy()
                z[~(z > 0)] = np.nan
                pixels[part, 0], pixels[part, 1] = self.image(x / z, y / z)
        return pixels

    def project_with_jacobian(self, points_m: ArrayLike) -> tuple[Array, Array]:
        """As ``project``, with d(pixel)/d(point) (N, 2, 3), px/m."""
        x, y, z = as_rows(points_m, 3).T.copy()
        z[~(z > 0)] = np.nan
        x, y = x / z, y / z
        u, v, by_xy = self.image_with_jacobian(x, y)
        jacobian = np.empty((len(z), 2, 3))
        jacobian[:, :, :2] = by_xy / z[:, None, None]
        jacobian[:, :, 2] = -(by_xy[:, :, 0] * x[:, None] + by_xy[:, :, 1] * y[:, None]) / z[:, None]
        return np.stack([u, v], axis=1), jacobian

    def pixels(self, xy: ArrayLike) -> Array:
        """Normalised coordinates x/z, y/z (N, 2) -> pixels (N, 2)."""
        return np.stack(self.image(*as_rows(xy, 2).T), axis=1)

    def normalise(self, pixels_px: ArrayLike) -> Array:
        """Pixels (N, 2) -> undistorted x/z, y/z (N, 2). NaN where no ray of the lens leads to the pixel."""
        pixels = as_rows(pixels_px, 2)
        xy = np.empty((len(pixels), 2))
        xy[:, 0], xy[:, 1] = (pixels[:, 0] - self.cx) / self.fx, (pixels[:, 1] - self.cy) / self.fy
        if self.distortion:
            with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
                for part in chunks(len(xy)):
                    xy[part, 0], xy[part, 1] = self._undistort(*xy[part].T.copy())
        return xy

    def _undistort(self, target_x: Array, target_y: Array) -> tuple[Array, Array]:
        """Newton's method from the distorted coordinates themselves; NaN where it does not settle inside the fold."""
        x, y = target_x.copy(), target_y.copy()
        for _ in range(_NEWTON_STEPS):
            dx, dy = self._newton_step(x, y, target_x, target_y)
            x -= dx
            y -= dy
            moved = np.maximum(abs(dx), abs(dy))
            if not np.any(moved > _LAST_STEP):
                break
        lost = ~(moved <= _LAST_STEP) | (x * x + y * y > self.fold_r2)
        x[lost] = y[lost] = np.nan
        return x, y

    def _newton_step(self, x: Array, y: Array, target_x: Array, target_y: Array) -> tuple[Array, Array]:
        xd, yd, (a, b, c, d) = _distort(x, y, self._twelve(), with_jacobian=True)
        ex, ey = xd - target_x, yd - target_y
        determinant = a * d - b * c
        return (d * ex - b * ey) / determinant, (a * ey - c * ex) / determinant

    def image(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Normalised x (N,), y (N,) -> pixel columns u (N,), v (N,): the fast form of ``pixels``."""
        if self.distortion:
            x, y = self._inside_fold(x, y)
            x, y, _ = _distort(x, y, self._twelve(), with_jacobian=False)
        return self.fx * x + self.cx, self.fy * y + self.cy

    def image_with_jacobian(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """u (N,), v (N,) and d(u, v)/d(x, y) (N, 2, 2)."""
        jacobian = np.zeros((len(x), 2, 2))
        jacobian[:, 0, 0], jacobian[:, 1, 1] = self.fx, self.fy
        if self.distortion:
            x, y = self._inside_fold(x, y)
            x, y, (a, b, c, d) = _distort(x, y, self._twelve(), with_jacobian=True)
            jacobian[:, 0, 0], jacobian[:, 0, 1] = self.fx * a, self.fx * b
            jacobian[:, 1, 0], jacobian[:, 1, 1] = self.fy * c, self.fy * d
        return self.fx * x + self.cx, self.fy * y + self.cy, jacobian

    def scaled(self, factor: float) -> Camera:
        """The same camera for images resized by ``factor``: pixel edges scale, and centres sit half a pixel inside."""
        return Camera(
            self.fx * factor,
            self.fy * factor,
            (self.cx + 0.5) * factor - 0.5,
            (self.cy + 0.5) * factor - 0.5,
            round(self.width * factor),
            round(self.height * factor),
            self.distortion,
        )

    def _twelve(self) -> tuple[float, ...]:
        return self.distortion + (0.0,) * (12 - len(self.distortion))

    def _inside_fold(self, x: Array, y: Array) -> tuple[Array, Array]:
        if self.fold_r2 == np.inf:
            return x, y
        return np.where(x * x + y * y <= self.fold_r2, x, np.nan), y


_Partials = tuple[Array, Array, Array, Array]


def _distort(x: Array, y: Array, k: tuple[float, ...], *, with_jacobian: bool) -> tuple[Array, Array, _Partials]:
    """Distorted coordinates and, where asked for, dxd/dx, dxd/dy, dyd/dx, dyd/dy."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = k
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    rational = k4 != 0 or k5 != 0 or k6 != 0
    below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6)) if rational else np.ones(1)
    if rational:
        radial /= below
    xy2 = 2 * x * y
    xd = x * radial + p1 * xy2 + p2 * (r2 + 2 * x * x)
    yd = y * radial + p2 * xy2 + p1 * (r2 + 2 * y * y)
    if s1 != 0 or s2 != 0 or s3 != 0 or s4 != 0:
        xd += r2 * (s1 + r2 * s2)
        yd += r2 * (s3 + r2 * s4)
    if not with_jacobian:
        return xd, yd, (x, x, x, x)
    slope = k1 + r2 * (2 * k2 + r2 * 3 * k3)
    if rational:
        slope = (slope - radial * (k4 + r2 * (2 * k5 + r2 * 3 * k6))) / below
    shared = xy2 * slope + 2 * p1 * x + 2 * p2 * y
    prism_x, prism_y = 2 * (s1 + 2 * s2 * r2), 2 * (s3 + 2 * s4 * r2)
    dxd_dx = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x + prism_x * x
    dyd_dy = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x + prism_y * y
    return xd, yd, (dxd_dx, shared + prism_x * y, shared + prism_y * x, dyd_dy)


def _fold_r2(k: tuple[float, ...]) -> float:
    """The smallest r^2 at which r * radial(r^2) stops growing (first root of its derivative); inf if it never does."""
    k1, k2, _, _, k3, k4, k5, k6 = k[:8]
    top, below = np.polynomial.Polynomial([1, k1, k2, k3]), np.polynomial.Polynomial([1, k4, k5, k6])
    s = np.polynomial.Polynomial([0, 1])
    growth = top * below + 2 * s * (top.deriv() * below - top * below.deriv())
    candidates = [growth.trim(1e-15).roots(), below.trim(1e-15).roots()]
    real = [r.real for roots in candidates for r in np.atleast_1d(roots) if abs(r.imag) < 1e-9 and r.real > 0]
    return float(min(real, default=np.inf))
