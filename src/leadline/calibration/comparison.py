"""What simpler models would cost: the error in millimetres of each where the refractive rig is taken for the truth.

Air pinhole: the lenses as in air, no refraction. In-water pinhole: Zhang's method on the images in water, its shift of
the pupil forgotten as usual. f': the lenses as in air with the focal length times the index, the paper's virtual focal
length before any laser.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leadline.calibration.board import Board
from leadline.calibration.cameras import WARP_PRIOR, CameraCalibration
from leadline.calibration.problem import WARP_NAMES, Fit, Prior, Problem
from leadline.calibration.start import board_pose
from leadline.calibration.views import POSE_NAMES, BoardView, lens_names, sights_of
from leadline.geometry import Camera, Pose
from leadline.rig import Rig
from leadline.rig_derivatives import Medium, point_sensitivity
from leadline.samples import Array

DISTANCES_M = (0.2, 0.5, 1.0, 1.5, 2.2)
PLACES = ("centre", "half field", "corner")
MARGIN = 0.1  # of the image's width and height: what is called the corner is so far inside of it


@dataclass(frozen=True, slots=True, eq=False)
class ModelError:
    """A model's error where the rig is taken for the truth: depth (D, 3) and whole (D, 3), mm, at DISTANCES_M, PLACES.

    NaN where not both cameras see.
    """

    name: str
    depth_mm: Array
    total_mm: Array


def field_points(rig: Rig, distances_m: Sequence[float] = DISTANCES_M, *, margin: float = MARGIN) -> Array:
    """Points (D, 3, 3), left frame, m: by distance; centre, halfway and the corner of what both cameras see, ``margin``
    (of the image's width and height) inside its border.

    NaN where the cameras' fields do not meet.
    """
    out = np.full((len(distances_m), 3, 3), np.nan)
    for i, z in enumerate(distances_m):
        shared = _shared_corner(rig, z, margin)
        if shared is None:
            continue
        centre, corner = shared
        pixels = np.array([centre, 0.5 * (centre + corner), corner])
        out[i] = _at_depth(rig, pixels, z)
    return out


def calibration_sigma_mm(rig: Rig, points_m: Array) -> tuple[Array, Array]:
    """Standard deviations from the rig's covariance at points (N, 3): of depth (N,) and of the whole (N,), mm."""
    names = tuple(n for n in rig.covariance.names if n != "water.group_index" and not n.startswith("laser."))
    sensitivity = point_sensitivity(rig, points_m, names) * 1e3
    cov = np.einsum("nij,jk,nlk->nil", sensitivity, rig.covariance.of(names), sensitivity)
    with np.errstate(invalid="ignore"):
        return np.sqrt(cov[:, 2, 2]), np.sqrt(np.trace(cov, axis1=1, axis2=2))


def comparison(calibration: CameraCalibration, pinhole: Rig | None) -> list[ModelError]:
    """The models beside the rig; ``pinhole`` from ``pinhole_in_water``. Empty for one camera or without a port."""
    rig = calibration.rig
    if calibration.mono or rig.port is None:
        return []
    points = field_points(rig)
    bare = dataclasses.replace(rig, port=None, water=None)
    models = [("air pinhole", bare), ("f' = index times f", _longer(bare, rig.port.outside_index))]
    if pinhole is not None:
        models.insert(1, ("in-water pinhole", pinhole))
    return [_error(name, model, rig, points) for name, model in models]


def pinhole_in_water(calibration: CameraCalibration) -> Fit | None:
    """Zhang's stereo calibration of the images in water; None without any."""
    views = [v for v in calibration.views if v.medium is Medium.WATER and v.left is not None]
    if not views:
        return None
    dry = [BoardView(v.name, Medium.AIR, v.left, v.right) for v in views]
    rig = calibration.rig
    index = 1.0 if rig.port is None else rig.port.outside_index
    start = Rig(_zoomed(rig.left, index), _zoomed(rig.right, index), rig.T_right_left)
    poses = [_pose(start, view, calibration.board) for view in dry]
    both = not calibration.mono
    names = (*lens_names("left"), *(lens_names("right") + POSE_NAMES if both else ()))
    priors = {name: Prior(0.0, 1.0) for name in names if "distortion" in name}
    if calibration.settings.warp:
        names, priors = names + WARP_NAMES, priors | dict.fromkeys(WARP_NAMES, WARP_PRIOR)
    return Problem(sights_of(dry, calibration.board), names, priors).solve(start, poses)


def _pose(rig: Rig, view: BoardView, board: Board) -> Pose:
    pose = None if view.left is None else board_pose(rig.left, view.left, board)
    return pose or Pose(np.eye(3), [0.0, 0.0, 1.0])


def _zoomed(camera: Camera, factor: float) -> Camera:
    return dataclasses.replace(camera, fx=camera.fx * factor, fy=camera.fy * factor, distortion=())


def _longer(rig: Rig, factor: float) -> Rig:
    """f' keeps the lens's distortion where it is in the image: its coefficients shrink with the slopes."""

    def lens(camera: Camera) -> Camera:
        k = camera.distortion
        powers = (2, 4, 1, 1, 6)
        scaled = tuple(c * factor**p for c, p in zip(k[:5], powers, strict=False))
        return dataclasses.replace(camera, fx=camera.fx * factor, fy=camera.fy * factor, distortion=scaled)

    return dataclasses.replace(rig, left=lens(rig.left), right=lens(rig.right))


def _error(name: str, model: Rig, rig: Rig, points_m: Array) -> ModelError:
    flat = points_m.reshape(-1, 3)
    seen = np.isfinite(flat).all(axis=1)
    off = np.full((len(flat), 3), np.nan)
    off[seen] = (model.triangulate(*rig.project(flat[seen]))[0] - flat[seen]) * 1e3
    shape = points_m.shape[:2]
    return ModelError(name, off[:, 2].reshape(shape), np.linalg.norm(off, axis=1).reshape(shape))


def _shared_corner(rig: Rig, z_m: float, share: float) -> tuple[Array, Array] | None:
    """Left pixels of the middle and of the upper right corner of the field that both cameras share at a depth."""
    width, height = rig.left.width, rig.left.height
    margin = share * width
    columns, row = np.linspace(margin, width - margin, 200), (height - 1) / 2
    points = _at_depth(rig, np.stack([columns, np.full_like(columns, row)], axis=1), z_m)
    u = rig.project(points)[1][:, 0]
    shared = columns[(u > margin) & (u < width - margin)]
    if not len(shared):
        return None
    return np.array([shared.mean(), row]), np.array([shared.max(), share * height])


def _at_depth(rig: Rig, left_px: Array, z_m: float) -> Array:
    origins, directions = rig.rays(left_px, "left")
    points: Array = origins + directions * ((z_m - origins[:, 2]) / directions[:, 2])[:, None]
    return points
