"""The rig: two cameras behind one flat port, water, a laser; as it is, in the left camera's frame.

Immutable. ``Rig.load`` reads a file or an example that ships with the package; ``Rig.save`` writes it whole or not at
all.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from leadline import rig_file
from leadline.geometry import Beam, Camera, LayeredPort, Pose, midpoints, triangulate
from leadline.geometry.arrays import as_rows
from leadline.pinhole import fit_pinhole
from leadline.rig_covariance import RigCovariance
from leadline.samples import Array
from leadline.water import Water

Side = Literal["left", "right"]
_SHIPPED = Path(__file__).parent / "rigs"


def shipped_rigs() -> list[str]:
    """Names of the example rigs that ``Rig.load`` takes in place of a path."""
    return sorted(path.stem for path in _SHIPPED.glob("*.yaml"))


_BEAM_NAMES = (
    *(f"laser.origin_m[{i}]" for i in range(3)),
    *(f"laser.direction[{i}]" for i in range(3)),
    "laser.range_scale",
    "laser.range_offset_m",
    "water.group_index",
)


@dataclass(frozen=True, eq=False)
class Rig:
    """Cameras, port, water and laser. Without a port it is an in-air rig: plain pinholes.

    T_right_left: p_right = R p_left + t. port: in the left camera's frame. pinhole_water: what an ordinary calibration
    in water gives for (left, right). virtual_focal_px: the paper's f' (x, y), px. T_body_left: the vehicle's frame.
    """

    left: Camera
    right: Camera
    T_right_left: Pose
    port: LayeredPort | None = None
    water: Water | None = None
    laser: Beam | None = None
    laser_wavelength_nm: float = 532.0
    pinhole_water: tuple[Camera, Camera] | None = None
    virtual_focal_px: tuple[float, float] | None = None
    T_body_left: Pose = field(default_factory=Pose.identity)
    covariance: RigCovariance = field(default_factory=RigCovariance)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    target_motion_m: tuple[float, float, float] = (0.0, 0.0, 0.0)  # see ``with_target_motion``; not of the rig's file

    def __post_init__(self) -> None:
        _ = self._right_port  # a right camera outside the port is a fault now, not at the first frame

    @classmethod
    def load(cls, source: str | Path) -> Rig:
        """A rig file, or an example by name (``shipped_rigs()``). InputError names a fault by its path in the file."""
        path = Path(source)
        if not path.is_file() and str(source) in shipped_rigs():
            path = _SHIPPED / f"{source}.yaml"
        return cls(**rig_file.read(path))

    def save(self, path: str | Path) -> None:
        """Write the rig file, whole or not at all. InputError where that cannot be done."""
        rig_file.write(Path(path), self)

    @property
    def baseline_m(self) -> float:
        return float(np.linalg.norm(self.T_right_left.t_m))

    @property
    def focal_outside_px(self) -> float:
        """The left camera's focal length as the water shows it near the axis, px; in air its own."""
        return self.left.fx * (1.0 if self.port is None else self.port.outside_index)

    @cached_property
    def T_left_right(self) -> Pose:
        return self.T_right_left.inverse()

    @cached_property
    def _shift_m(self) -> Array:
        return np.array(self.target_motion_m)

    @cached_property
    def _right_port(self) -> LayeredPort | None:
        return None if self.port is None else self.port.seen_from(self.T_right_left)

    def project(self, points_m: ArrayLike) -> tuple[Array, Array]:
        """Points (N, 3), left frame, m -> left and right pixels (N, 2), which may lie outside the image.

        NaN where a point is behind a camera, inside the port or beyond the lens's field.
        """
        return self.project_one(points_m, "left"), self.project_one(points_m, "right")

    def project_one(self, points_m: ArrayLike, camera: Side) -> Array:
        """As ``project``, for one camera (N, 2)."""
        lens, port = self._side(camera)
        points = as_rows(points_m, 3)
        here = points if camera == "left" else self.T_right_left.apply(points + self._shift_m)
        return lens.project(here) if port is None else port.project(lens, here)

    def project_with_jacobian(self, points_m: ArrayLike, camera: Side = "left") -> tuple[Array, Array]:
        """Pixels (N, 2) of one camera and d(pixel)/d(point in the left frame) (N, 2, 3), px/m."""
        lens, port = self._side(camera)
        points = as_rows(points_m, 3)
        here = points if camera == "left" else self.T_right_left.apply(points + self._shift_m)
        pixels, jacobian = lens.project_with_jacobian(here) if port is None else port.project_with_jacobian(lens, here)
        return pixels, jacobian if camera == "left" else jacobian @ self.T_right_left.R

    def rays(self, pixels_px: ArrayLike, camera: Side = "left") -> tuple[Array, Array]:
        """Pixels (N, 2) -> origins (N, 3), m, and unit directions (N, 3) in the water, both in the LEFT frame."""
        lens, port = self._side(camera)
        if port is None:
            xy = lens.normalise(pixels_px)
            sight = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)
            origins, directions = np.zeros((len(xy), 3)), sight / np.linalg.norm(sight, axis=1, keepdims=True)
        else:
            origins, directions = port.rays(lens, pixels_px)
        if camera == "left":
            return origins, directions
        return self.T_left_right.apply(origins) - self._shift_m, self.T_left_right.rotate(directions)

    def triangulate(self, left_px: ArrayLike, right_px: ArrayLike, sigma_px: ArrayLike = 0.1) -> tuple[Array, Array]:
        """Pixels (N, 2), (N, 2) -> points (N, 3), m, left frame, and covariance (N, 3, 3), m^2, of the pixels' noise.

        sigma_px: standard deviation of each pixel coordinate, one number or (N,). Maximum likelihood through the port.
        The rig's own covariance is not in it: its errors are common to all points. NaN where the rays do not meet.
        ValueError where left and right are not as many, or a sigma is below 0.
        """
        shapes = np.shape(left_px), np.shape(right_px)
        if shapes[0] != shapes[1]:
            raise ValueError(
                f"left_px {shapes[0]} and right_px {shapes[1]}: the same points in both, (N, 2) and (N, 2)"
            )
        start = midpoints(*self.rays(left_px, "left"), *self.rays(right_px, "right"))
        views = [lambda p: self.project_with_jacobian(p, "left"), lambda p: self.project_with_jacobian(p, "right")]
        return triangulate(views, [left_px, right_px], start, sigma_px)

    def laser_point(self, raw_m: float) -> tuple[Array, Array]:
        """A raw reading, m -> the lit point (3,), left frame, and its covariance (3, 3), m^2.

        The covariance has the reading's noise and the calibration's. ValueError where the rig has no laser.
        """
        if self.laser is None:
            raise ValueError("the rig has no laser")
        cov = self.laser.point_covariance_m2(raw_m, self.covariance.of(_BEAM_NAMES))
        return self.laser.point_m(raw_m), cov

    def in_water(self, water: Water) -> Rig:
        """The same rig in other water: its port and its laser change. ValueError for a rig without a port."""
        if self.port is None:
            raise ValueError("a rig without a port cannot be put into water")
        port = dataclasses.replace(self.port, outside_index=water.index)
        laser = None if self.laser is None else dataclasses.replace(self.laser, group_index=water.group_index)
        return dataclasses.replace(self, port=port, water=water, laser=laser)

    def with_target_motion(self, d_left_m: ArrayLike) -> Rig:
        """The rig for a target that moves by d (3,), m, left frame, from the left exposure to the right one.

        The right camera sees every point p at p + d, so that triangulation gives the place at the left exposure. What
        does not move with the target (the laser) is untouched.
        """
        x, y, z = (float(value) for value in np.asarray(d_left_m))
        moved = dataclasses.replace(self, target_motion_m=(x, y, z))
        for name in ("_right_port", "T_left_right"):  # computed once for all frames
            moved.__dict__[name] = getattr(self, name)
        return moved

    def scaled(self, factor: float) -> Rig:
        """The rig for images resized by ``factor``: everything in pixels scales, its covariance too."""
        pinhole, virtual = self.pinhole_water, self.virtual_focal_px
        return dataclasses.replace(
            self,
            left=self.left.scaled(factor),
            right=self.right.scaled(factor),
            pinhole_water=None if pinhole is None else (pinhole[0].scaled(factor), pinhole[1].scaled(factor)),
            virtual_focal_px=None if virtual is None else (virtual[0] * factor, virtual[1] * factor),
            covariance=self.covariance.scaled(factor),
        )

    def fit_pinhole_water(self) -> tuple[Camera, Camera]:
        """What an ordinary (Zhang) calibration in this water would give for (left, right); see ``leadline.pinhole``."""
        if self.port is None or self._right_port is None:
            return self.left, self.right
        return fit_pinhole(self.left, self.port), fit_pinhole(self.right, self._right_port)

    def _side(self, camera: Side) -> tuple[Camera, LayeredPort | None]:
        if camera not in ("left", "right"):
            raise ValueError(f"camera: must be 'left' or 'right', not {camera!r}")
        return (self.left, self.port) if camera == "left" else (self.right, self._right_port)
