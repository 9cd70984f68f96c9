"""What a rig says that a station of its laser shows, and how that moves with the rig's parameters: all analytic.

A station is five numbers: the spot's left u, v and right u, v, px, and the mean reading, m. Their one unknown is the
length L along the beam.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from leadline.geometry import Beam
from leadline.rig import Rig
from leadline.rig_derivatives import SIDES, by_parameters, medium_of, project
from leadline.samples import Array


def expected(rig: Rig, lengths_m: Array) -> Array:
    """(N, 5) for lengths (N,)."""
    beam = beam_of(rig)
    left, right = rig.project(beam.origin_m + lengths_m[:, None] * beam.direction)
    return np.column_stack([left, right, beam.range_scale * beam.group_index * lengths_m + beam.range_offset_m])


def by_length(rig: Rig, lengths_m: Array) -> Array:
    """d(expected)/d(own length) (N, 5)."""
    beam = beam_of(rig)
    points = beam.origin_m + lengths_m[:, None] * beam.direction
    pixels = [project(rig, side, medium_of(rig), points)[1] @ beam.direction for side in SIDES]
    return np.column_stack([*pixels, np.full(len(points), beam.range_scale * beam.group_index)])


def by_names(rig: Rig, lengths_m: Array, names: Sequence[str]) -> Array:
    """d(expected)/d(parameters) (N, 5, k); zero for the water's in air and for the port's of a rig without one."""
    beam = beam_of(rig)
    points = beam.origin_m + lengths_m[:, None] * beam.direction
    moved = np.stack([_moved(beam, lengths_m, name) for name in names], axis=-1)
    out = np.zeros((len(points), 5, len(names)))
    for row, side in zip((0, 2), SIDES, strict=True):
        pixels, by_point = project(rig, side, medium_of(rig), points)
        by_rig = by_parameters(rig, side, medium_of(rig), points, pixels, by_point, names)
        out[:, row : row + 2] = by_rig + by_point @ moved
    out[:, 4] = np.stack([_reading_moved(rig, beam, lengths_m, name) for name in names], axis=-1)
    return out


def beam_of(rig: Rig) -> Beam:
    """The rig's laser. ValueError where it has none."""
    if rig.laser is None:
        raise ValueError("the rig has no laser")
    return rig.laser


def _moved(beam: Beam, lengths_m: Array, name: str) -> Array:
    """d(the beam's point)/d(parameter) (N, 3); a direction stays a unit vector."""
    part, _, key = name.partition("[")
    if part not in ("laser.origin_m", "laser.direction"):
        return np.zeros((len(lengths_m), 3))
    axis = np.eye(3)[int(key[:-1])]
    if part == "laser.origin_m":
        return np.tile(axis, (len(lengths_m), 1))
    across = axis - beam.direction * (beam.direction @ axis)
    return np.asarray(lengths_m[:, None] * across)


def _reading_moved(rig: Rig, beam: Beam, lengths_m: Array, name: str) -> Array:
    match name:
        case "laser.range_scale":
            return beam.group_index * lengths_m
        case "laser.range_offset_m":
            return np.ones_like(lengths_m)
        case "water.group_index" if rig.water is not None:
            return beam.range_scale * lengths_m
    return np.zeros_like(lengths_m)
