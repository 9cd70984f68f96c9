"""Mistakes of a calibration's images that the numbers betray, each said in one line."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from leadline.calibration.board import Board
from leadline.calibration.derivatives import Medium
from leadline.calibration.start import camera_from
from leadline.calibration.views import BoardView
from leadline.errors import InputError
from leadline.geometry import Pose
from leadline.rig import Rig

FEWEST = 3
"""Views of one medium, below which its parameters are not fixed at all."""
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
    sets = [v.left for v in views if v.medium is Medium.WATER and v.left is not None]
    if not sets or len(sets) == len(views):
        return
    size = (rig.left.width, rig.left.height)
    ratio = camera_from(sets, board, size).fx / rig.left.fx
    if ratio < 0.85:
        raise InputError("the images in water were taken in air, those in air in water", "", "swap --air and --water")
    if ratio < 1.13:
        what = f"the images in water look as in air (focal lengths' ratio {ratio:.2f}, in water 1.34)"
        fix = "the board must be in the water, beyond the glass"
        raise InputError(what, "--water", fix)
