"""What limits a calibration, and which images would help most: arithmetic on the normal equations, no new images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leadline.calibration.board import Board
from leadline.calibration.cameras import CameraCalibration
from leadline.calibration.group_index import GROUP
from leadline.calibration.laser import LASER
from leadline.calibration.problem import Problem, Sight
from leadline.calibration.views import SIDES
from leadline.geometry import Pose
from leadline.rig import Rig, Side
from leadline.rig_derivatives import Medium, point_sensitivity, project
from leadline.rig_parameters import turn
from leadline.samples import Array

GROUPS = {
    "the lenses": ("left.", "right."),
    "the pose between the cameras": ("T_right_left.",),
    "the port": ("port.",),
    "the water's index": ("water.index",),
}
LASER_GROUPS = {
    "the beam's direction": ("laser.direction",),
    "its origin and the range's offset": ("laser.origin_m", "laser.range_offset_m"),
    "the range's scale": ("laser.range_scale",),
    "the water's group index": ("water.group_index",),
}
BEAM = (*LASER, GROUP)
"""As in ``geometry.beam.BEAM_PARAMETERS``."""
EXTRA = 6
"""Images that a suggestion asks for."""
_TILTS = ((0.0, 0.0), (0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5), (0.35, 0.35))
_PLACES = {
    "in the middle": (0.0, 0.0),
    "in the upper left": (-0.26, -0.15),
    "in the upper right": (0.26, -0.15),
    "in the lower left": (-0.26, 0.15),
    "in the lower right": (0.26, 0.15),
}
_NEAR_FAR_M = (0.4, 0.8, 1.6)


@dataclass(frozen=True, slots=True)
class Suggestion:
    """Six images of one kind, and the depth's standard deviation, mm, that they would leave (before, after)."""

    medium: Medium
    distance_m: float
    where: str
    before_mm: float
    after_mm: float

    def __str__(self) -> str:
        return (
            f"take {EXTRA} more images in {self.medium} with the board at {self.distance_m:.1f} m {self.where} "
            f"(depth sigma {self.before_mm:.2f} -> {self.after_mm:.2f} mm)"
        )


def limits(rig: Rig, points_m: Array) -> dict[str, float]:
    """The share of the depth's variance, mean over points (N, 3), that goes once a group of parameters is known."""
    names = rig.covariance.names
    return _shares(point_sensitivity(rig, points_m, names)[:, 2:], names, rig.covariance.matrix, GROUPS)


def laser_limits(rig: Rig, lengths_m: Sequence[float]) -> dict[str, float]:
    """The same of the lit point's variance, mean over lengths of the beam; empty for a laser that is exact."""
    beam = rig.laser
    if beam is None or not set(BEAM) & set(rig.covariance.names):
        return {}
    sensitivity = np.array([beam.point_jacobian(beam.raw_m(length)) for length in lengths_m])
    return _shares(sensitivity, BEAM, rig.covariance.of(BEAM), LASER_GROUPS)


def _shares(
    sensitivity: Array, names: Sequence[str], cov: Array, groups: dict[str, tuple[str, ...]]
) -> dict[str, float]:
    """By group, the share of the variance of what moves by ``sensitivity`` (N, d, k) that goes once it is known."""
    total, out = _variance(sensitivity, cov), {}
    for group, starts in groups.items():
        known = np.array([name.startswith(starts) for name in names]) & (np.diag(cov) > 0)
        if known.any():
            out[group] = float(1 - np.mean(_variance(sensitivity, _given(cov, known)) / total))
    return out


def _variance(sensitivity: Array, cov: Array) -> Array:
    return np.asarray(np.einsum("ndj,jk,ndk->n", sensitivity, cov, sensitivity))


def suggestion(calibration: CameraCalibration, points_m: Array) -> Suggestion | None:
    """The images that would lower the mean depth variance at points (N, 3) most; None where no board fits the view."""
    rig, fit = calibration.rig, calibration.fit
    information = _inverse(fit.covariance)
    depth = point_sensitivity(rig, points_m, fit.names)[:, 2] * 1e3
    before = _mean_sigma(depth, fit.covariance)
    best: Suggestion | None = None
    for medium in sorted(calibration.media()):
        for z_m in _NEAR_FAR_M:
            for where, (x, y) in _PLACES.items():
                extra = _information(calibration, medium, np.array([x, y, 1.0]) * z_m)
                if extra is None:
                    continue
                after = _mean_sigma(depth, _inverse(information + extra))
                if best is None or after < best.after_mm:
                    best = Suggestion(medium, z_m, where, before, after)
    return best


def with_air(calibration: CameraCalibration, points_m: Array) -> tuple[float, float]:
    """Depth's standard deviation, mm, mean over points (N, 3), of boards in water alone, and with them in air too."""
    fit, rig, board = calibration.fit, calibration.rig, calibration.board
    sights = [
        _sight(board, view, side, Medium.AIR, project(rig, side, Medium.AIR, pose.apply(board.points_m))[0])
        for view, pose in enumerate(fit.poses)
        for side in SIDES[: 1 if calibration.mono else 2]
    ]
    extra = Problem(sights, fit.names).information(rig, fit.poses, fit.sigma_px)
    depth = point_sensitivity(rig, points_m, fit.names)[:, 2] * 1e3
    return _mean_sigma(depth, fit.covariance), _mean_sigma(depth, _inverse(_inverse(fit.covariance) + extra))


def _information(calibration: CameraCalibration, medium: Medium, place_m: Array) -> Array | None:
    """(G, G) from EXTRA boards around a place, their poses free; None where fewer than half of them are in the view."""
    fit, rig, board = calibration.fit, calibration.rig, calibration.board
    poses, sights = list[Pose](), list[Sight]()
    for tilt in _TILTS:
        R = turn(np.array([*tilt, 0.0]))
        pose = Pose(R, place_m - R @ board.points_m.mean(axis=0))
        for side in SIDES[: 1 if calibration.mono else 2]:
            sight = _imagined(rig, board, pose, len(poses), medium, side == "left")
            if sight is not None:
                sights.append(sight)
        poses.append(pose)
    if len(sights) < len(_TILTS):
        return None
    return Problem(sights, fit.names).information(rig, poses, fit.sigma_px)


def _imagined(rig: Rig, board: Board, pose: Pose, view: int, medium: Medium, left: bool) -> Sight | None:
    side: Side = "left" if left else "right"
    q, _ = project(rig, side, medium, pose.apply(board.points_m))
    inside = np.isfinite(q).all() and (q > 0).all() and (q < (rig.left.width - 1, rig.left.height - 1)).all()
    return _sight(board, view, side, medium, q) if inside else None


def _sight(board: Board, view: int, side: Side, medium: Medium, pixels: Array) -> Sight:
    return Sight(view, side, medium, board.points_m, pixels, board.bow)


def _mean_sigma(depth: Array, cov: Array) -> float:
    return float(np.sqrt(np.einsum("nj,jk,nk->n", depth, cov, depth).mean()))


def _inverse(information: Array) -> Array:
    scale = 1 / np.sqrt(np.diag(information))
    out: Array = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    return out


def _given(cov: Array, known: NDArray[np.bool_]) -> Array:
    """The covariance once some parameters are known (Schur complement); theirs is 0."""
    free = ~known
    out = np.zeros_like(cov)
    scale = 1 / np.sqrt(np.diag(cov)[~free])
    cross = cov[np.ix_(free, ~free)] * scale
    inverse = np.linalg.pinv(cov[np.ix_(~free, ~free)] * np.outer(scale, scale), rcond=1e-10, hermitian=True)
    out[np.ix_(free, free)] = cov[np.ix_(free, free)] - cross @ inverse @ cross.T
    return out


def spread(poses: Sequence[Pose]) -> float:
    """How many times farther the farthest board is than the nearest."""
    z = [float(pose.t_m[2]) for pose in poses]
    return max(z) / max(min(z), 1e-6)
