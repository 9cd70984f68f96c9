"""How far the calibration's own uncertainty moves a measured point.

The errors are common to all frames: they do not average out, and a filter must not treat them as noise of one frame.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from leadline.rig import Rig
from leadline.rig_derivatives import point_sensitivity
from leadline.samples import Array

NEAREST_M, FARTHEST_M, DEPTHS = 0.05, 20.0, 20
ACROSS = 13  # nodes over the field, each way


def position_cov(rig: Rig, point_m: ArrayLike) -> Array:
    """(3, 3) m^2: the calibration's part of a stereo point's covariance, straight from the definition."""
    names = _stereo_names(rig)
    if not names:
        return np.zeros((3, 3))
    sensitivity = point_sensitivity(rig, np.asarray(point_m, float)[None], names)[0]
    return np.asarray(sensitivity @ rig.covariance.of(names) @ sensitivity.T)


def beam_cov(rig: Rig, raw_m: float) -> Array:
    """(3, 3) m^2: the calibration's part of the laser point's covariance. ValueError where the rig has no laser."""
    if rig.laser is None:
        raise ValueError("the rig has no laser")
    return np.asarray(rig.laser_point(raw_m)[1] - rig.laser.point_covariance_m2(raw_m))


class CalibrationError:
    """``position_cov`` from a table over the field of view, for use in every frame (some 50 us a point)."""

    def __init__(self, rig: Rig) -> None:
        names = _stereo_names(rig)
        self._root = rig.covariance.root(names)
        z_m = np.geomspace(NEAREST_M, FARTHEST_M, DEPTHS)
        slopes = _field(rig)
        self._axes = (z_m, *(np.linspace(*ends, ACROSS) for ends in slopes))
        z, x, y = np.meshgrid(*self._axes, indexing="ij")
        points = np.stack([x * z, y * z, z], axis=-1).reshape(-1, 3)
        table = point_sensitivity(rig, points, names) @ self._root if names else np.zeros((len(points), 3, 0))
        # Divided by the depth, an error of scale or of disparity is linear in z: interpolation is exact for both.
        self._table = (table / points[:, 2, None, None]).reshape(*z.shape, 3, -1)
        self._known = np.isfinite(self._table).all(axis=(-1, -2))
        self._table[~self._known] = 0.0

    def at(self, point_m: ArrayLike) -> Array:
        """(3, 3) m^2, left frame, for a point (3,) before the cameras; beyond the field, that of the nearest place."""
        p = np.asarray(point_m, dtype=np.float64)
        depth = max(float(p[2]), NEAREST_M)
        places = zip(self._axes, (depth, p[0] / depth, p[1] / depth), strict=True)
        (i, along_z), (j, along_x), (k, along_y) = (_cell(axis, value) for axis, value in places)
        cell = np.s_[i : i + 2, j : j + 2, k : k + 2]
        weights = along_z[:, None, None] * along_x[:, None] * along_y * self._known[cell]
        total = float(weights.sum())
        if total == 0:
            return np.full((3, 3), np.nan)
        factor = np.tensordot(weights, self._table[cell], 3) * (depth / total)
        return np.asarray(factor @ factor.T)


def _stereo_names(rig: Rig) -> tuple[str, ...]:
    """The uncertain parameters that a stereo point depends on."""
    return tuple(n for n in rig.covariance.names if not n.startswith("laser.") and n != "water.group_index")


def _field(rig: Rig) -> tuple[tuple[float, float], tuple[float, float]]:
    """The slopes x/z and y/z at the borders of the left image, outside the port."""
    u, v = np.linspace(0, rig.left.width - 1, 9), np.linspace(0, rig.left.height - 1, 9)
    border = [(a, b) for a in u for b in (v[0], v[-1])] + [(a, b) for a in (u[0], u[-1]) for b in v]
    directions = rig.rays(np.array(border))[1]
    slopes = (directions[:, :2] / directions[:, 2:])[np.isfinite(directions).all(axis=1)]
    if len(slopes) == 0:
        slopes = np.array([[-0.1, -0.1], [0.1, 0.1]])
    low, high = slopes.min(axis=0), slopes.max(axis=0)
    return (float(low[0]), float(high[0])), (float(low[1]), float(high[1]))


def _cell(axis: Array, value: float) -> tuple[int, Array]:
    """The interval of an axis that holds a value, and the weights (2,) of its ends; the outermost hold beyond."""
    low = min(max(int(np.searchsorted(axis, value)) - 1, 0), len(axis) - 2)
    part = min(max((value - axis[low]) / (axis[low + 1] - axis[low]), 0.0), 1.0)
    return low, np.array([1 - part, part])
