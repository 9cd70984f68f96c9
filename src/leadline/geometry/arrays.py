"""Small checks and chunking that the other geometry files share."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from leadline.samples import Array

CHUNK = 16384  # points: large enough to hide the interpreter, small enough that the temporaries stay in cache


def as_rows(values: ArrayLike, width: int) -> Array:
    """Values as an (N, width) float array; ValueError for another shape."""
    rows = np.asarray(values, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != width:
        raise ValueError(f"expected an array of shape (N, {width}), got {rows.shape}")
    return rows


def as_vector(values: ArrayLike, name: str) -> Array:
    """Three finite numbers as a read-only (3,) array; ValueError names the argument."""
    vector = np.array(values, dtype=np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ValueError(f"{name}: must be three finite numbers")
    vector.flags.writeable = False
    return vector


def as_unit(values: ArrayLike, name: str) -> Array:
    """A direction as a read-only unit (3,) array; ValueError where its length is off by more than 0.001 (rounding)."""
    vector = as_vector(values, name)
    length = float(np.linalg.norm(vector))
    if abs(length - 1.0) > 1e-3:
        raise ValueError(f"{name}: must be a unit vector, its length is {length:.6g}")
    unit: Array = vector / length if abs(length - 1.0) > 1e-15 else vector
    unit.flags.writeable = False
    return unit


def across(direction: Array) -> Array:
    """Two unit vectors (2, 3) at right angles to each other and to a direction (3,): to the right, and down."""
    x, y, z = direction.tolist()
    flat, length = math.hypot(x, z), math.sqrt(x * x + y * y + z * z)
    if flat == 0:
        return np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -math.copysign(1.0, y)]])
    x, y, z, right_x, right_z = x / length, y / length, z / length, z / flat, -x / flat
    return np.array([[right_x, 0.0, right_z], [y * right_z, z * right_x - x * right_z, -y * right_x]])


def chunks(count: int) -> Iterator[slice]:
    """Slices that cover ``range(count)`` in cache-sized pieces."""
    return (slice(start, min(start + CHUNK, count)) for start in range(0, count, CHUNK))
