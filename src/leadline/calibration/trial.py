"""The calibration that the images taken so far would give: it has the last word on whether they are enough."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leadline.calibration.board import Board
from leadline.calibration.cameras import CameraSettings, calibrate_cameras
from leadline.calibration.comparison import calibration_sigma_mm, field_points
from leadline.calibration.verdict import best_images, cross_check, verdict
from leadline.calibration.views import BoardView
from leadline.calibration.warp import warp_of
from leadline.errors import InputError
from leadline.rig import Rig

FIRST = 8
"""Pairs, from which a trial is worth its time."""
DISTANCES_M = (0.5, 1.0, 2.2)
MATCH_PX = 0.1
"""A match's noise, per camera: what a position costs that a good calibration must not make much worse."""
SHARE = 0.15
"""Of it, that the calibration alone may cost at 2.2 m, in the picture's corner too."""
_OTHER_MEDIUM = "no images in"  # of a verdict on one medium alone


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """rig: None where nothing came of it. depth_mm: one standard deviation of the depth (3, 3) by DISTANCES_M and place
    (centre, half field, corner). unfit: names of the pairs that do not fit the others. doubts: why it is not good.
    warp: the board is bent, and was let bend."""

    rig: Rig | None
    depth_mm: tuple[tuple[float, ...], ...]
    unfit: tuple[str, ...]
    doubts: tuple[str, ...]
    warp: bool = False

    @property
    def good(self) -> bool:
        return self.rig is not None and not self.doubts and not self.unfit


def trial(views: Sequence[BoardView], board: Board, size: tuple[int, int], settings: CameraSettings) -> Trial:
    """Calibrate by views of one medium, with what is known beforehand. Never raises for images that are no good."""
    try:
        calibration = calibrate_cameras(views, board, size, settings)
    except InputError as error:
        return Trial(None, (), (), (error.what,))
    if not settings.warp and warp_of(calibration).sure:
        return trial(views, board, size, dataclasses.replace(settings, warp=True))
    judged = verdict(calibration, cross_check(calibration), best_images(calibration))
    unfit = tuple(dict.fromkeys(one.name for one in calibration.left_out))
    doubts = [one for one in judged.doubts if not one.startswith(_OTHER_MEDIUM) and not one.startswith("left out")]
    points = field_points(calibration.rig, DISTANCES_M)
    sigma_mm = calibration_sigma_mm(calibration.rig, points.reshape(-1, 3))[0].reshape(points.shape[:2])
    allowed_mm = SHARE * match_mm(calibration.rig, DISTANCES_M[-1])
    worst_mm = float(np.nanmax(sigma_mm[-1]))
    if not worst_mm <= allowed_mm:
        doubts.append(f"the depth at {DISTANCES_M[-1]} m would be good to {worst_mm:.1f} mm only, not {allowed_mm:.1f}")
    depth_mm = tuple(tuple(float(one) for one in row) for row in sigma_mm)
    return Trial(calibration.rig, depth_mm, unfit, tuple(doubts), settings.warp)


def match_mm(rig: Rig, distance_m: float) -> float:
    """One standard deviation of the depth, mm, by a match of MATCH_PX in each camera."""
    f = rig.left.fx * (1.0 if rig.port is None else rig.port.outside_index)
    return 1e3 * distance_m**2 * MATCH_PX * 2**0.5 / (f * float(np.linalg.norm(rig.T_right_left.t_m)))
