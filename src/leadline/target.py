"""Target shapes: what is located, and how a state relates to a range and to the beam.

A target's vector is x = (position (3,), shape (k,)), in the left camera's frame, metres:

| target   | position                       | shape, where it is estimated                   | range to            |
|----------|--------------------------------|------------------------------------------------|---------------------|
| Sphere   | centre                         | radius                                         | the nearest surface |
| Plane    | foot of the perpendicular      | -                                              | the foot            |
| Cylinder | axis point nearest the camera  | axis angle about the line of sight, radius     | the nearest surface |
| Surface  | nearest measured point         | how far behind its tangent plane the beam hits | that point          |

``range``, ``distance`` and ``beam_length`` give a value and its gradient over x: all that an estimator needs. A plane
is wholly described by its foot, and a cylinder's axis is perpendicular to the line to its nearest point: no number of
the state is spare.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from leadline.samples import Array

LEAST_RADIUS_M = 0.01


class Target(Protocol):
    """What the localizer needs of a shape. Arrays of N points or beams in, arrays of N out."""

    @property
    def name(self) -> str: ...

    @property
    def shape_mean(self) -> Array:
        """(k,) what is believed of the estimated shape before the first measurement."""
        ...

    @property
    def shape_sigma(self) -> Array:
        """(k,) its standard deviation."""
        ...

    @property
    def shape_walk(self) -> Array:
        """(k,) how much the shape may change, per square root of a second: a ball never, another place of a lump."""
        ...

    def possible(self, x: Array) -> bool:
        """Whether there can be such a thing: its size is one."""
        ...

    def range(self, x: Array) -> tuple[float, Array]:
        """Distance from the origin to the nearest point of the surface, and its gradient (3 + k,)."""
        ...

    def distance(self, x: Array, points_m: Array) -> tuple[Array, Array]:
        """Signed distance (N,) of points (N, 3) from the surface, positive outside, and its gradient (N, 3 + k)."""
        ...

    def normals(self, x: Array, points_m: Array) -> Array:
        """Outward unit normals (N, 3) of the surface nearest to points (N, 3)."""
        ...

    def beam_length(self, x: Array, origins_m: Array, directions: Array) -> tuple[Array, Array]:
        """Length (N,) of beams (N, 3), (N, 3) to the surface, and gradient (N, 3 + k); NaN where a beam passes by."""
        ...


def range_with_sigma(target: Target, x: Array, cov: Array) -> tuple[float, float]:
    """Distance to the nearest point of the surface and its sigma, m, of a target's vector with its covariance."""
    distance, gradient = target.range(x)
    return distance, float(np.sqrt(gradient @ cov @ gradient))


@dataclass(frozen=True, slots=True)
class Sphere:
    """A ball. Without a diameter the radius is estimated, from what is expected: a hand's width to a buoy's."""

    diameter_m: float | None = None
    expected_radius_m: float = 0.2
    expected_radius_sigma_m: float = 0.15

    def __post_init__(self) -> None:
        _check(self.diameter_m)

    @property
    def name(self) -> str:
        return "sphere" if self.diameter_m is None else f"sphere:{self.diameter_m:g}"

    @property
    def shape_mean(self) -> Array:
        return np.array([self.expected_radius_m]) if self.diameter_m is None else np.empty(0)

    @property
    def shape_sigma(self) -> Array:
        return np.array([self.expected_radius_sigma_m]) if self.diameter_m is None else np.empty(0)

    def radius_m(self, x: Array) -> float:
        return float(x[3]) if self.diameter_m is None else self.diameter_m / 2

    def possible(self, x: Array) -> bool:
        return self.radius_m(x) > LEAST_RADIUS_M

    @property
    def shape_walk(self) -> Array:
        return np.zeros(0 if self.diameter_m is not None else 1)

    def range(self, x: Array) -> tuple[float, Array]:
        distance = float(np.linalg.norm(x[:3]))
        return distance - self.radius_m(x), np.concatenate([x[:3] / distance, -np.ones(len(x) - 3)])

    def distance(self, x: Array, points_m: Array) -> tuple[Array, Array]:
        outward = points_m - x[:3]
        length = np.sqrt(np.einsum("ni,ni->n", outward, outward))
        gradient = -np.ones((len(length), len(x)))
        gradient[:, :3] = -outward / length[:, None]
        return length - self.radius_m(x), gradient

    def normals(self, x: Array, points_m: Array) -> Array:
        return _unit(points_m - x[:3])

    def beam_length(self, x: Array, origins_m: Array, directions: Array) -> tuple[Array, Array]:
        radius = self.radius_m(x)
        to_centre = x[:3] - origins_m
        along = np.einsum("ni,ni->n", to_centre, directions)
        inside = radius**2 - np.einsum("ni,ni->n", to_centre, to_centre) + along**2
        length = along - np.sqrt(np.where((inside > 0) & (along > 0), inside, np.nan))
        normal = (length[:, None] * directions - to_centre) / radius
        cosine = np.einsum("ni,ni->n", normal, directions)[:, None]  # negative; near zero at the limb
        return length, np.column_stack([normal / cosine, *[1 / cosine] * (len(x) - 3)])


def is_known_ball(target: Target) -> bool:
    """Whether its outline alone says how far it is."""
    return isinstance(target, Sphere) and target.diameter_m is not None


@dataclass(frozen=True, slots=True)
class Plane:
    """A flat wall or hull: its position is the foot of the perpendicular, which gives its normal too."""

    name: str = "plane"

    @property
    def shape_mean(self) -> Array:
        return np.empty(0)

    @property
    def shape_sigma(self) -> Array:
        return np.empty(0)

    @property
    def shape_walk(self) -> Array:
        return np.empty(0)

    def possible(self, x: Array) -> bool:
        return True

    def range(self, x: Array) -> tuple[float, Array]:
        distance = float(np.linalg.norm(x))
        return distance, x / distance

    def distance(self, x: Array, points_m: Array) -> tuple[Array, Array]:
        length = float(np.linalg.norm(x[:3]))
        along = points_m @ x[:3] / length
        gradient = -points_m / length + (along / length**2)[:, None] * x[:3] + x[:3] / length
        return length - along, gradient

    def normals(self, x: Array, points_m: Array) -> Array:
        return np.broadcast_to(-x[:3] / np.linalg.norm(x[:3]), points_m.shape)

    def beam_length(self, x: Array, origins_m: Array, directions: Array) -> tuple[Array, Array]:
        return _beams_to_plane(x[:3], origins_m, directions)


def _beams_to_plane(foot_m: Array, origins_m: Array, directions: Array) -> tuple[Array, Array]:
    """The plane p.foot = |foot|^2: L = (|foot|^2 - origin.foot) / (direction.foot)."""
    towards = directions @ foot_m
    grazing = towards <= 0.05 * np.linalg.norm(foot_m)  # within 3 degrees there is no useful reading
    towards = np.where(grazing, np.nan, towards)
    length = (foot_m @ foot_m - origins_m @ foot_m) / towards
    return length, (2 * foot_m - origins_m - length[:, None] * directions) / towards[:, None]


@dataclass(frozen=True, slots=True)
class Cylinder:
    """A pile or pipe. The axis stands at an angle about the line of sight (0: image-vertical)."""

    diameter_m: float | None = None

    def __post_init__(self) -> None:
        _check(self.diameter_m)

    @property
    def name(self) -> str:
        return "cylinder" if self.diameter_m is None else f"cylinder:{self.diameter_m:g}"

    @property
    def shape_mean(self) -> Array:
        return np.array([0.0, 0.25]) if self.diameter_m is None else np.array([0.0])

    @property
    def shape_sigma(self) -> Array:
        return np.array([1.0, 0.2]) if self.diameter_m is None else np.array([1.0])

    def radius_m(self, x: Array) -> float:
        return float(x[4]) if self.diameter_m is None else self.diameter_m / 2

    def possible(self, x: Array) -> bool:
        return self.radius_m(x) > LEAST_RADIUS_M

    def axis(self, x: Array) -> Array:
        """Unit direction of the axis (3,), perpendicular to the line to the position."""
        down, aside = self._across(x)
        return np.asarray(np.cos(x[3]) * down + np.sin(x[3]) * aside)

    def _across(self, x: Array) -> tuple[Array, Array]:
        """Unit directions (3,), (3,) across the line to the position: down in the image, and the other one."""
        sx, sy, sz = x[:3] / np.sqrt(x[:3] @ x[:3])
        flat = np.sqrt(1 - sy**2)
        return np.array([-sx * sy, flat**2, -sy * sz]) / flat, np.array([-sz, 0.0, sx]) / flat

    def _axis_by(self, x: Array) -> Array:
        """(3, 4) derivative of the axis by the position and the angle."""
        down, aside = self._across(x)
        length = np.sqrt(x[:3] @ x[:3])
        sight, cosine, sine = x[:3] / length, np.cos(x[3]), np.sin(x[3])
        axis_by = np.empty((3, 4))
        axis_by[:, 3] = cosine * aside - sine * down
        # As the line of sight moves, the axis tips to stay across it, and turns about it with the image's down.
        axis = cosine * down + sine * aside
        spin = -(sight[1] / down[1]) * aside / length
        axis_by[:, :3] = -np.outer(sight, axis) / length + np.outer(axis_by[:, 3], spin)
        return axis_by

    @property
    def shape_walk(self) -> Array:
        return np.array([0.1, 0.0]) if self.diameter_m is None else np.array([0.1])

    def range(self, x: Array) -> tuple[float, Array]:
        distance = float(np.linalg.norm(x[:3]))
        gradient = np.concatenate([x[:3] / distance, [0.0], -np.ones(len(x) - 4)])
        return distance - self.radius_m(x), gradient

    def distance(self, x: Array, points_m: Array) -> tuple[Array, Array]:
        axis, axis_by = self.axis(x), self._axis_by(x)
        to_point = points_m - x[:3]
        along = to_point @ axis
        outward = to_point - along[:, None] * axis
        length = np.sqrt(np.einsum("ni,ni->n", outward, outward))
        normal = outward / length[:, None]
        gradient = -np.ones((len(length), len(x)))
        gradient[:, :4] = -along[:, None] * (normal @ axis_by)
        gradient[:, :3] -= normal
        return length - self.radius_m(x), gradient

    def normals(self, x: Array, points_m: Array) -> Array:
        axis, to_point = self.axis(x), points_m - x[:3]
        return _unit(to_point - np.outer(to_point @ axis, axis))

    def beam_length(self, x: Array, origins_m: Array, directions: Array) -> tuple[Array, Array]:
        length = self._length(x, origins_m, directions)
        ends = origins_m + length[:, None] * directions
        cosine = np.einsum("ni,ni->n", self.normals(x, ends), directions)
        return length, -self.distance(x, ends)[1] / cosine[:, None]  # the end stays on the surface

    def _length(self, x: Array, origins_m: Array, directions: Array) -> Array:
        axis = self.axis(x)
        across = directions - np.outer(directions @ axis, axis)
        to_axis = x[:3] - origins_m
        to_axis = to_axis - np.outer(to_axis @ axis, axis)
        a = np.einsum("ni,ni->n", across, across)
        b = np.einsum("ni,ni->n", across, to_axis)
        inside = b**2 - a * (np.einsum("ni,ni->n", to_axis, to_axis) - self.radius_m(x) ** 2)
        hits = (inside > 0) & (b > 0) & (a > 0)
        return np.asarray((b - np.sqrt(np.where(hits, inside, np.nan))) / np.where(hits, a, 1.0))


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.sqrt(np.einsum("ni,ni->n", vectors, vectors))[:, None])


@dataclass(frozen=True, slots=True)
class Surface:
    """Nothing is assumed but a tangent plane at the nearest point; the beam hits ``bulge`` behind it."""

    name: str = "surface"

    @property
    def shape_mean(self) -> Array:
        return np.array([0.0])

    @property
    def shape_sigma(self) -> Array:
        return np.array([0.05])

    @property
    def shape_walk(self) -> Array:
        return np.array([0.05])

    def possible(self, x: Array) -> bool:
        return True

    def range(self, x: Array) -> tuple[float, Array]:
        distance = float(np.linalg.norm(x[:3]))
        return distance, np.concatenate([x[:3] / distance, [0.0]])

    def distance(self, x: Array, points_m: Array) -> tuple[Array, Array]:
        distance, gradient = Plane().distance(x, points_m)
        return distance, np.column_stack([gradient, np.zeros(len(distance))])

    def normals(self, x: Array, points_m: Array) -> Array:
        return Plane().normals(x, points_m)

    def beam_length(self, x: Array, origins_m: Array, directions: Array) -> tuple[Array, Array]:
        length, gradient = _beams_to_plane(x[:3], origins_m, directions)
        return length + x[3], np.column_stack([gradient, np.ones(len(length))])


def _check(diameter_m: float | None) -> None:
    if diameter_m is not None and not 0 < diameter_m < np.inf:
        raise ValueError(f"diameter_m: must be metres above 0, or None where it is not known, not {diameter_m:g}")


def parse_target(text: str) -> Sphere | Plane | Cylinder | Surface:
    """`sphere:0.34`, `sphere`, `plane`, `cylinder:0.5`, `cylinder`, `surface`; ValueError says what is wrong."""
    shape, _, size = text.partition(":")
    diameter = None
    if size:
        try:
            diameter = float(size)
        except ValueError:
            diameter = -1.0
        if not 0.01 <= diameter <= 50:
            raise ValueError(f"{size!r} is not a diameter in metres between 0.01 and 50")
    match shape:
        case "sphere":
            return Sphere(diameter)
        case "cylinder":
            return Cylinder(diameter)
        case "plane" | "surface" if diameter is None:
            return Plane() if shape == "plane" else Surface()
    raise ValueError(
        f"{text!r} is not a target; use sphere, sphere:DIAMETER, plane, cylinder, cylinder:DIAMETER or surface"
    )
