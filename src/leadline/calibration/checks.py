"""Mistakes of a calibration's images that the numbers betray, each said in one line."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from leadline.calibration.board import Board
from leadline.calibration.problem import Prior, Problem
from leadline.calibration.start import camera_from, view_pose
from leadline.calibration.views import BoardView, lens_names, sights_of
from leadline.errors import InputError
from leadline.geometry import Camera, Pose
from leadline.rig import Rig
from leadline.rig_derivatives import Medium

FEWEST = 3
"""Views of one medium, below which its parameters are not fixed at all."""
_SURELY_LONGER = 1.25  # focal lengths from homographies alone err by a tenth
_BASELINE_M = (0.005, 5.0)


def check_views(views: Sequence[BoardView]) -> None:
    """InputError where a medium has too few boards."""
    for medium, total in Counter(v.medium for v in views).items():
        found = sum(v.medium is medium and (v.left is not None or v.right is not None) for v in views)
        if found < FEWEST:
            what = f"the board was found in {found} of {total} images in {medium}"
            raise InputError(what, "", "check --board (it counts INNER corners), sharpness and light; take 15 or more")


def check_sides(T_right_left: Pose) -> None:
    """InputError where the right camera is left of the left one, or the baseline is none of a rig's."""
    x, y, _ = T_right_left.t_m
    if x > 0 and x > 3 * abs(y):
        raise InputError("the right camera stands left of the left one", "", "swap the left and right images")
    length = float(np.linalg.norm(T_right_left.t_m))
    if not _BASELINE_M[0] < length < _BASELINE_M[1]:
        fix = "check --square (metres) and that left and right images go together"
        raise InputError(f"the cameras come out {length:.3g} m apart", "--square", fix)


def check_focal_lengths(rig: Rig, views: Sequence[BoardView], board: Board) -> None:
    """InputError where the images in water do not look longer by the water's index than those in air."""
    wet = [v for v in views if v.medium is Medium.WATER and v.left is not None]
    if not wet or all(v.medium is Medium.WATER for v in views):
        return
    ratio = _pinhole(wet, board, rig.left).fx / rig.left.fx
    if ratio < 0.85:
        raise InputError("the images in water were taken in air, those in air in water", "", "swap --air and --water")
    if ratio < 1.13:
        what = f"the images in water look as in air (focal lengths' ratio {ratio:.2f}, in water 1.34)"
        fix = "the board must be in the water, beyond the glass"
        raise InputError(what, "--water", fix)


def _pinhole(views: Sequence[BoardView], board: Board, like: Camera) -> Camera:
    """The pinhole that explains the left images best, whatever they were taken in."""
    alone = [BoardView(v.name, Medium.AIR, v.left) for v in views]
    lens = camera_from([v.left for v in views if v.left is not None], board, (like.width, like.height))
    if lens.fx > _SURELY_LONGER * like.fx:
        return lens
    rig = Rig(lens, lens, Pose.identity())
    poses = [view_pose(rig, view, board) or Pose(np.eye(3), [0.0, 0.0, 1.0]) for view in alone]
    names = lens_names("left")
    priors = {name: Prior(0.0, 0.5) for name in names if "distortion" in name}
    return Problem(sights_of(alone, board), names, priors).solve(rig, poses).rig.left
