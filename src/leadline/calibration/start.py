"""Where the bundle adjustment starts: focal length from homographies, poses from planes, one camera from the other."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from leadline.calibration.board import Board, Corners
from leadline.calibration.views import BoardView
from leadline.geometry import Camera, Pose
from leadline.rig import Rig
from leadline.rig_derivatives import SIDES, Medium
from leadline.samples import Array


def camera_from(sets: Sequence[Corners], board: Board, size: tuple[int, int]) -> Camera:
    """A pinhole with its principal point in the middle of the image (width, height), from whole boards.

    Zhang's two constraints for each view give 1/f^2; a weighted median keeps bad corner sets and boards square to the
    axis, which say nothing about f, from counting. Without any answer f is the image's width.
    """
    width, height = size
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    answers = [_inverse_f2(corners.pixels - centre, board.points_m[corners.ids]) for corners in sets]
    known = [(value, weight) for value, weight in answers if value > 0]
    f = float(width)
    if known:
        values, weights = np.array(known).T
        order = np.argsort(values)
        middle = np.searchsorted(np.cumsum(weights[order]), weights.sum() / 2)
        f = float(np.clip(1 / np.sqrt(values[order][middle]), 0.2 * width, 20 * width))
    return Camera(f, f, float(centre[0]), float(centre[1]), width, height)


def _inverse_f2(centred_px: Array, points_m: Array) -> tuple[float, float]:
    """1/f^2 of one view and its weight."""
    scale = float(np.abs(centred_px).max())
    H: Any = cv2.findHomography(points_m[:, :2], centred_px / scale)[0]
    if H is None:
        return 0.0, 0.0
    (a, b, _), (c, d, _), (e, f, _) = H / np.linalg.norm(H)
    left = np.array([a * b + c * d, a * a + c * c - b * b - d * d])
    right = np.array([-e * f, f * f - e * e])
    weight = float(left @ left)
    return float(left @ right) / max(weight, 1e-300) / scale**2, weight


def board_pose(camera: Camera, corners: Corners, board: Board) -> Pose | None:
    """T_camera_board of a plane seen by a pinhole; None where the corners fit none in front of the camera."""
    xy = camera.normalise(corners.pixels)
    seen = np.isfinite(xy).all(axis=1)
    if seen.sum() < 6:
        return None
    points = board.points_m[corners.ids][seen]
    found, turn, t = cv2.solvePnP(points, xy[seen], np.eye(3), np.zeros(0), flags=cv2.SOLVEPNP_IPPE)
    if not found or not np.isfinite(t).all() or t[2] <= 0:
        return None
    return Pose(cv2.Rodrigues(turn)[0], t.ravel())


def view_pose(rig: Rig, view: BoardView, board: Board) -> Pose | None:
    """T_left_board from one camera's corners: in water a pinhole sees as if f were longer by the index."""
    for side in SIDES:
        corners = view.corners(side)
        lens = rig.left if side == "left" else rig.right
        if view.medium is Medium.WATER and rig.port is not None:
            index = rig.port.outside_index
            lens = dataclasses.replace(lens, fx=lens.fx * index, fy=lens.fy * index)
        pose = None if corners is None else board_pose(lens, corners, board)
        if pose is not None:
            return pose if side == "left" else rig.T_left_right @ pose
    return None


def between(left: Sequence[Pose], right: Sequence[Pose]) -> Pose:
    """T_right_left from the same boards in both cameras: the pair nearest to the median, so that bad pairs are idle."""
    pairs = [r @ p.inverse() for p, r in zip(left, right, strict=True)]
    shifts = np.array([pair.t_m for pair in pairs])
    off = np.linalg.norm(shifts - np.median(shifts, axis=0), axis=1)
    return pairs[int(np.argmin(off))]
