"""What limits a calibration, and which images would help most: arithmetic on the normal equations, no new images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leadline.calibration.board import Board
from leadline.calibration.cameras import CameraCalibration
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
    sensitivity = point_sensitivity(rig, points_m, names)[:, 2]
    cov = rig.covariance.matrix
    total = np.einsum("nj,jk,nk->n", sensitivity, cov, sensitivity)
    out = {}
    for group, starts in GROUPS.items():
        known = np.array([name.startswith(starts) for name in names])
        if known.any():
            left = _given(cov, known)
            out[group] = float(1 - np.mean(np.einsum("nj,jk,nk->n", sensitivity, left, sensitivity) / total))
    return out


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


def _given(cov: Array, known: Array) -> Array:
    """The covariance once some parameters are known (Schur complement); theirs is 0."""
    free = ~known.astype(bool)
    out = np.zeros_like(cov)
    cross = cov[np.ix_(free, ~free)]
    out[np.ix_(free, free)] = cov[np.ix_(free, free)] - cross @ np.linalg.solve(cov[np.ix_(~free, ~free)], cross.T)
    return out


def spread(poses: Sequence[Pose]) -> float:
    """How many times farther the farthest board is than the nearest."""
    z = [float(pose.t_m[2]) for pose in poses]
    return max(z) / max(min(z), 1e-6)
