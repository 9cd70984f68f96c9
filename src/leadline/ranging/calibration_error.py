"""How far the calibration's own uncertainty moves a measured point.

The errors are common to all frames: they do not average out, and a filter must not treat them as noise of one frame.
"""

from __future__ import annotations

from bisect import bisect_left

import numpy as np
from numpy.typing import ArrayLike

from leadline.rig import Rig
from leadline.rig_derivatives import point_sensitivity
from leadline.samples import Array

NEAREST_M, FARTHEST_M, DEPTHS = 0.05, 20.0, 20
ACROSS = 13  # nodes over the field, each way
CORNERS = np.array([(a * ACROSS + b) * ACROSS + c for a in (0, 1) for b in (0, 1) for c in (0, 1)])  # of a cell


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
    """``position_cov`` from a table over the field of view, for use in every frame."""

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
        self._table = (table / points[:, 2, None, None]).reshape(len(points), -1)
        self._known = np.isfinite(self._table).all(axis=1)
        self._table[~self._known] = 0.0
        self._plain = [axis.tolist() for axis in self._axes]  # one place at a time: Python's numbers are faster

    def at(self, point_m: ArrayLike) -> Array:
        """(3, 3) m^2, left frame, for a point (3,) before the cameras; beyond the field, that of the nearest place."""
        x, y, z = (float(v) for v in np.asarray(point_m))
        depth = max(z, NEAREST_M)
        (i, far), (j, right), (k, below) = map(_cell, self._plain, (depth, x / depth, y / depth))
        nodes = ((i * ACROSS + j) * ACROSS + k) + CORNERS
        weights = self._known[nodes] * [
            a * b * c for a in (1 - far, far) for b in (1 - right, right) for c in (1 - below, below)
        ]
        total = float(weights.sum())
        if total == 0:
            return np.full((3, 3), np.nan)
        factor = (weights * (depth / total) @ self._table[nodes]).reshape(3, -1)
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


def _cell(axis: list[float], value: float) -> tuple[int, float]:
    """The interval of an axis that holds a value, and how far along it is; the outermost hold beyond."""
    low = min(max(bisect_left(axis, value) - 1, 0), len(axis) - 2)
    return low, min(max((value - axis[low]) / (axis[low + 1] - axis[low]), 0.0), 1.0)
