"""The laser rangefinder's beam: raw = range_scale * group_index * L + range_offset_m, point = origin + L * direction.

L is the geometric length in metres. Light travels at c / group_index, so a device that counts time reads group_index
times too far in water.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from leadline.geometry.arrays import as_unit, as_vector
from leadline.samples import Array

BEAM_PARAMETERS = (
    *(f"origin_m[{i}]" for i in range(3)),
    *(f"direction[{i}]" for i in range(3)),
    "range_scale",
    "range_offset_m",
    "group_index",
)
"""What ``Beam.point_jacobian`` differentiates by, in order."""


@dataclass(frozen=True, slots=True, eq=False)
class Beam:
    """Origin (3,) m and unit direction (3,) in the left camera's frame, in the medium where it is used.

    range_sigma_m: standard deviation of one raw reading. ValueError for a direction that is not a unit vector, a scale
    that is not positive or a group index below 1.
    """

    origin_m: Array
    direction: Array
    range_scale: float
    range_offset_m: float
    group_index: float
    range_sigma_m: float

    def __init__(
        self,
        origin_m: ArrayLike,
        direction: ArrayLike,
        range_scale: float = 1.0,
        range_offset_m: float = 0.0,
        group_index: float = 1.0,
        *,
        range_sigma_m: float = 0.003,
    ) -> None:
        object.__setattr__(self, "origin_m", as_vector(origin_m, "origin_m"))
        object.__setattr__(self, "direction", as_unit(direction, "direction"))
        object.__setattr__(self, "range_scale", float(range_scale))
        object.__setattr__(self, "range_offset_m", float(range_offset_m))
        object.__setattr__(self, "group_index", float(group_index))
        object.__setattr__(self, "range_sigma_m", float(range_sigma_m))
        if not 0 < self.range_scale < np.inf:
            raise ValueError("range_scale: must be positive")
        if not np.isfinite(self.range_offset_m):
            raise ValueError("range_offset_m: must be finite")
        if not 1 <= self.group_index < np.inf:
            raise ValueError("group_index: must be at least 1")
        if not 0 <= self.range_sigma_m < np.inf:
            raise ValueError("range_sigma_m: must be 0 or more")

    @property
    def length_sigma_m(self) -> float:
        """Standard deviation of L from one reading's noise."""
        return self.range_sigma_m / (self.range_scale * self.group_index)

    def length_m(self, raw_m: float) -> float:
        """Geometric length L of a raw reading."""
        return (raw_m - self.range_offset_m) / (self.range_scale * self.group_index)

    def raw_m(self, length_m: float) -> float:
        """The reading that the device gives for a geometric length."""
        return self.range_scale * self.group_index * length_m + self.range_offset_m

    def point_m(self, raw_m: float) -> Array:
        """The lit point (3,), left camera's frame."""
        return np.asarray(self.origin_m + self.length_m(raw_m) * self.direction)

    def point_jacobian(self, raw_m: float) -> Array:
        """d(point)/d(BEAM_PARAMETERS) (3, 9) at a raw reading."""
        length, d = self.length_m(raw_m), self.direction[:, None]
        by_direction = length * (np.eye(3) - d @ d.T)  # only what turns the beam counts: |d| stays 1
        by_offset = -d / (self.range_scale * self.group_index)
        return np.hstack(
            [np.eye(3), by_direction, -d * length / self.range_scale, by_offset, -d * length / self.group_index]
        )

    def point_covariance_m2(self, raw_m: float, parameters_cov: Array | None = None) -> Array:
        """(3, 3) from the reading's noise and, where given, the covariance (9, 9) of BEAM_PARAMETERS."""
        cov = self.length_sigma_m**2 * np.outer(self.direction, self.direction)
        if parameters_cov is not None:
            jacobian = self.point_jacobian(raw_m)
            cov = cov + jacobian @ parameters_cov @ jacobian.T
        return np.asarray(cov)


def refract_direction(direction: ArrayLike, normal: ArrayLike, index_from: float, index_to: float) -> Array:
    """Unit direction (3,) behind a flat window with unit normal (3,) (Snell; the window's own index drops out).

    ValueError where the light is totally reflected or does not go towards the normal's side.
    """
    d, n = as_unit(direction, "direction"), as_unit(normal, "normal")
    if float(d @ n) <= 0:
        raise ValueError("direction: must go to the side of the window's normal")
    across = (d - (d @ n) * n) * (index_from / index_to)
    inside = 1.0 - float(across @ across)
    if inside <= 0:
        raise ValueError("direction: totally reflected at the window")
    return np.asarray(across + np.sqrt(inside) * n)
