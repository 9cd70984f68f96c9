"""Target shapes: what is located, and how a state relates to a range and to the beam.

A target's vector is x = (position (3,), shape (k,)), in the left camera's frame, metres:

| target   | position                              | shape, where it is estimated              | range                      |
|----------|---------------------------------------|-------------------------------------------|----------------------------|
| Sphere   | centre                                | radius                                    | to the nearest surface     |
| Plane    | foot of the perpendicular from origin | -                                         | to the foot                |
| Cylinder | axis point nearest the camera         | axis angle about the line of sight, radius | to the nearest surface     |
| Surface  | nearest measured point                | how far behind its tangent plane the beam hits | to that point         |

``range`` and ``beam_length`` return a value and its gradient over x, which is all that an estimator needs. A plane is
wholly described by its foot, and a cylinder's axis is perpendicular to the line to its nearest point: no state is spare.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from leadline.samples import Array


class Target(Protocol):
    """What the localizer needs of a shape."""

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

    def range(self, x: Array) -> tuple[float, Array]:
        """Distance from the origin to the nearest point of the surface, and its gradient (3 + k,)."""
        ...

    def beam_length(self, x: Array, origin_m: Array, direction: Array) -> tuple[float, Array] | None:
        """Length of a beam from its origin to the surface, and its gradient; None where the beam passes by."""
        ...

    def nearest_point(self, x: Array) -> Array:
        """(3,) the point of the surface nearest to the origin."""
        ...


def _gradient(f: Callable[[Array], float | None], x: Array, step: float = 1e-6) -> Array | None:
    """Central differences; None where the function is undefined beside x (the limb of a shape)."""
    columns = []
    for i in range(len(x)):
        d = np.zeros_like(x)
        d[i] = step
        high, low = f(x + d), f(x - d)
        if high is None or low is None:
            return None
        columns.append((high - low) / (2 * step))
    return np.array(columns)


@dataclass(frozen=True, slots=True)
class Sphere:
    """A ball. Without a diameter the radius is estimated, between a hand's width and a buoy's."""

    diameter_m: float | None = None

    @property
    def name(self) -> str:
        return "sphere" if self.diameter_m is None else f"sphere:{self.diameter_m:g}"

    @property
    def shape_mean(self) -> Array:
        return np.array([0.2]) if self.diameter_m is None else np.empty(0)

    @property
    def shape_sigma(self) -> Array:
        return np.array([0.15]) if self.diameter_m is None else np.empty(0)

    def radius_m(self, x: Array) -> float:
        return float(x[3]) if self.diameter_m is None else self.diameter_m / 2

    def range(self, x: Array) -> tuple[float, Array]:
        distance = float(np.linalg.norm(x[:3]))
        gradient = np.concatenate([x[:3] / distance, -np.ones(len(x) - 3)])
        return distance - self.radius_m(x), gradient

    def nearest_point(self, x: Array) -> Array:
        point: Array = x[:3] * (1 - self.radius_m(x) / np.linalg.norm(x[:3]))
        return point

    def beam_length(self, x: Array, origin_m: Array, direction: Array) -> tuple[float, Array] | None:
        radius = self.radius_m(x)
        to_centre = x[:3] - origin_m
        along = float(to_centre @ direction)
        inside = radius**2 - float(to_centre @ to_centre) + along**2
        if inside <= 0 or along <= 0:
            return None
        length = along - np.sqrt(inside)
        normal = (origin_m + length * direction - x[:3]) / radius
        cosine = float(normal @ direction)  # negative; near zero at the limb
        gradient = np.concatenate([normal / cosine, np.full(len(x) - 3, 1 / cosine)])
        return float(length), gradient


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

    def range(self, x: Array) -> tuple[float, Array]:
        distance = float(np.linalg.norm(x))
        return distance, x / distance

    def nearest_point(self, x: Array) -> Array:
        return x[:3]

    def beam_length(self, x: Array, origin_m: Array, direction: Array) -> tuple[float, Array] | None:
        return _beam_to_plane(x, origin_m, direction)


def _beam_to_plane(foot_m: Array, origin_m: Array, direction: Array) -> tuple[float, Array] | None:
    """The plane p.foot = |foot|^2: L = (|foot|^2 - origin.foot) / (direction.foot)."""
    towards = float(foot_m @ direction)
    if towards <= 0.05 * np.linalg.norm(foot_m):  # within 3 degrees of grazing there is no useful reading
        return None
    length = (float(foot_m @ foot_m) - float(origin_m @ foot_m)) / towards
    return length, (2 * foot_m - origin_m - length * direction) / towards


@dataclass(frozen=True, slots=True)
class Cylinder:
    """A pile or pipe. The axis stands at ``angle`` about the line of sight (0: image-vertical)."""

    diameter_m: float | None = None

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

    def axis(self, x: Array) -> Array:
        """Unit direction of the axis (3,), perpendicular to the line to the position."""
        sight = x[:3] / np.linalg.norm(x[:3])
        down = np.array([0.0, 1.0, 0.0]) - sight[1] * sight
        down /= np.linalg.norm(down)
        axis: Array = np.cos(x[3]) * down + np.sin(x[3]) * np.cross(sight, down)
        return axis

    def angle(self, position_m: Array, axis: Array) -> float:
        """The inverse of ``axis``: the angle in (-pi/2, pi/2] of a given axis at a given position."""
        sight = position_m / np.linalg.norm(position_m)
        down = np.array([0.0, 1.0, 0.0]) - sight[1] * sight
        angle = np.arctan2(axis @ np.cross(sight, down / np.linalg.norm(down)), axis @ down / np.linalg.norm(down))
        return float((angle + np.pi / 2) % np.pi - np.pi / 2)

    def range(self, x: Array) -> tuple[float, Array]:
        distance = float(np.linalg.norm(x[:3]))
        gradient = np.zeros_like(x)
        gradient[:3] = x[:3] / distance
        gradient[4:] = -1.0
        return distance - self.radius_m(x), gradient

    def nearest_point(self, x: Array) -> Array:
        point: Array = x[:3] * (1 - self.radius_m(x) / np.linalg.norm(x[:3]))
        return point

    def beam_length(self, x: Array, origin_m: Array, direction: Array) -> tuple[float, Array] | None:
        length = self._length(x, origin_m, direction)
        gradient = _gradient(lambda y: self._length(y, origin_m, direction), x)
        return None if length is None or gradient is None else (length, gradient)

    def _length(self, x: Array, origin_m: Array, direction: Array) -> float | None:
        axis = self.axis(x)
        across = direction - (direction @ axis) * axis
        to_axis = x[:3] - origin_m
        to_axis = to_axis - (to_axis @ axis) * axis
        a, b = float(across @ across), float(across @ to_axis)
        inside = b**2 - a * (float(to_axis @ to_axis) - self.radius_m(x) ** 2)
        return None if inside <= 0 or a == 0 or b <= 0 else (b - float(np.sqrt(inside))) / a


@dataclass(frozen=True, slots=True)
class Surface:
    """Nothing is assumed but that the nearest point's tangent plane faces us; where the beam hits lies ``bulge`` behind it."""

    name: str = "surface"

    @property
    def shape_mean(self) -> Array:
        return np.array([0.0])

    @property
    def shape_sigma(self) -> Array:
        return np.array([0.05])

    def range(self, x: Array) -> tuple[float, Array]:
        distance = float(np.linalg.norm(x[:3]))
        return distance, np.concatenate([x[:3] / distance, [0.0]])

    def nearest_point(self, x: Array) -> Array:
        return x[:3]

    def beam_length(self, x: Array, origin_m: Array, direction: Array) -> tuple[float, Array] | None:
        plane = _beam_to_plane(x[:3], origin_m, direction)
        return None if plane is None else (plane[0] + float(x[3]), np.concatenate([plane[1], [1.0]]))


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
    raise ValueError(f"{text!r} is not a target; use sphere, sphere:DIAMETER, plane, cylinder, cylinder:DIAMETER or surface")
