"""The pinhole that best imitates a camera behind a flat port in water: what an ordinary calibration in water finds."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from leadline.geometry import Camera, LayeredPort
from leadline.samples import Array

DISTANCES_M = (0.5, 0.8, 1.2, 1.7, 2.2)


def fit_pinhole(camera: Camera, port: LayeredPort) -> Camera:
    """fx, fy, cx, cy, k1, k2 that make the pixels of points all over the image at DISTANCES_M smallest wrong.

    The pupil may move, as it does in Zhang's method, where each board's pose takes up the shift that refraction makes;
    like there, the shift is then forgotten. That and the change of refraction with distance are this model's errors.
    """
    pixels, points = _seen(camera, port)

    def residuals(x: Array) -> Array:
        predicted = _pinhole(camera, x).project(points + x[6:9])
        return np.asarray(np.nan_to_num(predicted - pixels, nan=1e3).ravel())

    focal = port.outside_index
    start = np.array([camera.fx * focal, camera.fy * focal, camera.cx, camera.cy, 0.0, 0.0, 0.0, 0.0, 0.0])
    scale = np.array([1000.0, 1000.0, 1000.0, 1000.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    return _pinhole(camera, np.asarray(least_squares(residuals, start, x_scale=scale, method="lm").x))


def _pinhole(camera: Camera, x: Array) -> Camera:
    fx, fy, cx, cy, k1, k2 = (float(value) for value in x[:6])
    return Camera(fx, fy, cx, cy, camera.width, camera.height, (k1, k2, 0.0, 0.0))


def _seen(camera: Camera, port: LayeredPort) -> tuple[Array, Array]:
    """Pixels (N, 2) on a grid, once for each distance, and the points (N, 3), camera frame, that they see there."""
    columns, rows = np.linspace(0, camera.width - 1, 16), np.linspace(0, camera.height - 1, 9)
    grid = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    origins, directions = port.rays(camera, grid)
    points = [origins + directions * ((z - origins[:, 2]) / directions[:, 2])[:, None] for z in DISTANCES_M]
    pixels, seen = np.tile(grid, (len(DISTANCES_M), 1)), np.concatenate(points)
    known = np.isfinite(seen).all(axis=1)
    return pixels[known], seen[known]
