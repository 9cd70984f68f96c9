"""Rigid transforms. ``T_to_from.apply(p_from)`` gives ``p_to = R p_from + t``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from leadline.geometry.arrays import as_vector
from leadline.samples import Array


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A rotation ``R`` (3, 3) and a translation ``t_m`` (3,). ValueError unless R is a rotation within 0.001.

    Printed matrices are rounded; R is replaced by the nearest true rotation, so that distances are kept.
    """

    R: Array
    t_m: Array

    def __init__(self, R: ArrayLike, t_m: ArrayLike) -> None:
        object.__setattr__(self, "R", _rotation(R))
        object.__setattr__(self, "t_m", as_vector(t_m, "t_m"))

    @classmethod
    def identity(cls) -> Pose:
        return cls(np.eye(3), np.zeros(3))

    def apply(self, points: ArrayLike) -> Array:
        """Points (N, 3) or (3,), metres, from the pose's `from` frame into its `to` frame."""
        moved: Array = np.asarray(points, dtype=np.float64) @ self.R.T + self.t_m
        return moved

    def rotate(self, directions: ArrayLike) -> Array:
        """Directions (N, 3) or (3,): rotated, not moved."""
        turned: Array = np.asarray(directions, dtype=np.float64) @ self.R.T
        return turned

    def inverse(self) -> Pose:
        return Pose(self.R.T, -self.R.T @ self.t_m)

    def __matmul__(self, other: Pose) -> Pose:
        """T_c_b @ T_b_a = T_c_a."""
        return Pose(self.R @ other.R, self.R @ other.t_m + self.t_m)


def _rotation(values: ArrayLike) -> Array:
    R = np.array(values, dtype=np.float64)
    if R.shape != (3, 3) or not np.isfinite(R).all():
        raise ValueError("R: must be 3x3 finite numbers")
    if not np.allclose(R @ R.T, np.eye(3), atol=1e-3) or np.linalg.det(R) < 0:
        raise ValueError("R: must be a rotation matrix")
    if not np.allclose(R @ R.T, np.eye(3), rtol=0, atol=1e-14):
        u, _, vt = np.linalg.svd(R)
        R = u @ vt
    R.flags.writeable = False
    return R
