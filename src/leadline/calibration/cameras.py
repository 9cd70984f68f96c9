"""`calibrate cameras`: cameras, their pose, the port and the water's index at once, from boards in air and in water.

One bundle adjustment over all images. Images in air fix the lenses, images in water the port and the index; each keeps
the other honest. Corner sets that do not fit are left out by name.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leadline.calibration.board import Board, Corners
from leadline.calibration.checks import check_focal_lengths, check_sides, check_views
from leadline.calibration.outliers import LeftOut, without_outliers
from leadline.calibration.problem import WARP_NAMES, Fit, Prior, Problem
from leadline.calibration.start import between, board_pose, camera_from, view_pose
from leadline.calibration.views import (
    LAYER_NAMES,
    PORT_NAMES,
    POSE_NAMES,
    SIDES,
    BoardView,
    lens_names,
    numbered_alike,
    sights_of,
)
from leadline.errors import InputError
from leadline.geometry import Camera, LayeredPort, Pose
from leadline.rig import Rig, Side
from leadline.rig_covariance import RigCovariance
from leadline.rig_derivatives import Medium
from leadline.water import CHANNEL_NM, Water, WaterState

WIDE_INDEX = Prior(1.338, 0.004)
STATED_INDEX_SIGMA = 0.001
WARP_PRIOR = Prior(0.0, 0.002)
GUESSED_LAYER = {LAYER_NAMES[0]: Prior(0.002, 0.001), LAYER_NAMES[1]: Prior(1.52, 0.03)}
_DISTORTION_SIGMA = (1.0, 1.0, 0.03, 0.03, 0.5)
_START_DISTANCE_M = 0.02
_AIR = (Medium.AIR, Medium.AIR_BEHIND_PORT)


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """What is known beforehand. Thickness and index of the port: exact where given, else parameters with a prior.

    warp: the board may be bent, by parabolas along its rows and columns that are estimated with the rest.
    """

    port_thickness_m: float | None = None
    port_index: float | None = None
    water_state: WaterState | None = None
    warp: bool = False

    @property
    def index_prior(self) -> Prior:
        if self.water_state is None:
            return WIDE_INDEX
        return Prior(self.water_state.index(CHANNEL_NM["green"]), STATED_INDEX_SIGMA)


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """A calibrated rig, the fit behind it and what was left out.

    views: those used, ``fit.poses`` and ``Sight.view`` in their order; mono: one camera only (the rig's right camera is
    then a copy of its left at the same place). priors: those of the fit, by parameter.
    """

    rig: Rig
    fit: Fit
    board: Board
    problem: Problem
    views: tuple[BoardView, ...]
    mono: bool
    left_out: tuple[LeftOut, ...]
    corners_left_out: int
    settings: CameraSettings

    @property
    def priors(self) -> dict[str, Prior]:
        return self.problem.priors

    def media(self) -> set[Medium]:
        return {view.medium for view in self.views}


def calibrate_cameras(
    views: Sequence[BoardView], board: Board, size: tuple[int, int], settings: CameraSettings = CameraSettings()
) -> CameraCalibration:
    """From the corners of all views; ``size`` is the images' (width, height). InputError for views that are no use."""
    check_views(views)
    views = numbered_alike([v for v in views if v.left is not None or v.right is not None], board)
    mono = all(v.right is None for v in views)
    start, poses = _start(views, board, size, mono)
    solved: dict[int, Pose] = {}
    dry = [i for i, v in enumerate(views) if v.medium in _AIR]
    if dry and len(dry) < len(views):
        # the lenses first; for a start a port between air and air is none
        air = [dataclasses.replace(views[i], medium=Medium.AIR) for i in dry]
        problem = Problem(sights_of(air, board), _names(air, mono, settings), _priors(start, air, mono, settings))
        fit = problem.solve(start, [poses[i] for i in dry])
        start, solved = fit.rig, dict(zip(dry, fit.poses, strict=True))
    check_focal_lengths(start, views, board)
    start = _with_port(start, views, settings)
    if solved:
        poses = [solved.get(i) or view_pose(start, v, board) or poses[i] for i, v in enumerate(views)]
    names, priors = _names(views, mono, settings), _priors(start, views, mono, settings)
    found = without_outliers(views, board, lambda kept: Problem(kept, names, priors), start, poses)
    rig = _finished(found.fit, settings)
    gone = tuple(found.left_out)
    return CameraCalibration(
        rig, found.fit, board, found.problem, tuple(found.views), mono, gone, found.corners_left_out, settings
    )


def _start(views: Sequence[BoardView], board: Board, size: tuple[int, int], mono: bool) -> tuple[Rig, list[Pose]]:
    """Pinholes, the right camera's pose, the boards' poses. Water alone: as in air, with the index taken off f."""
    basis = [v for v in views if v.medium in _AIR] or list(views)
    in_water = not any(v.medium in _AIR for v in views)
    lenses: dict[Side, Camera] = {}
    for side in SIDES:
        sets = [c for v in basis if (c := v.corners(side)) is not None]
        lenses[side] = camera_from(sets, board, size) if sets else lenses["left"]
    seen = {side: [_pose(lenses[side], v.corners(side), board) for v in views] for side in SIDES}
    pairs = [(a, b) for a, b, v in zip(seen["left"], seen["right"], views, strict=True) if a and b and v in basis]
    if not pairs and not mono:
        raise InputError("no pair shows the board in both images", "", "check that left and right images go together")
    T = Pose.identity() if mono else between(*map(list, zip(*pairs, strict=True)))
    if not mono:
        check_sides(T)
    poses = [
        a or (T.inverse() @ b if b else Pose(np.eye(3), [0.0, 0.0, 1.0]))
        for a, b in zip(seen["left"], seen["right"], strict=True)
    ]
    if in_water:
        lenses = {side: _in_air(lens) for side, lens in lenses.items()}
    return Rig(lenses["left"], lenses["left" if mono else "right"], T), poses


def _in_air(lens: Camera) -> Camera:
    return dataclasses.replace(lens, fx=lens.fx / WIDE_INDEX.mean, fy=lens.fy / WIDE_INDEX.mean)


def _lenses(rig: Rig) -> dict[Side, Camera]:
    return {"left": rig.left, "right": rig.right}


def _pose(camera: Camera, corners: Corners | None, board: Board) -> Pose | None:
    return None if corners is None else board_pose(camera, corners, board)


def _with_port(rig: Rig, views: Sequence[BoardView], settings: CameraSettings) -> Rig:
    if all(v.medium is Medium.AIR for v in views):
        return rig
    thickness = GUESSED_LAYER[LAYER_NAMES[0]].mean if settings.port_thickness_m is None else settings.port_thickness_m
    index = GUESSED_LAYER[LAYER_NAMES[1]].mean if settings.port_index is None else settings.port_index
    ahead_m = max(0.0, float(rig.T_left_right.t_m[2]))  # of the right pupil; both are behind the glass
    port = LayeredPort((0, 0, 1), _START_DISTANCE_M + ahead_m, ((thickness, index),), settings.index_prior.mean)
    return dataclasses.replace(rig, port=port)


def _names(views: Sequence[BoardView], mono: bool, settings: CameraSettings) -> tuple[str, ...]:
    names = lens_names("left") if mono else (*lens_names("left"), *lens_names("right"), *POSE_NAMES)
    bent = WARP_NAMES if settings.warp else ()
    media = {v.medium for v in views}
    if media == {Medium.AIR}:
        return names + bent
    names += PORT_NAMES
    names += LAYER_NAMES[:1] if settings.port_thickness_m is None else ()
    names += LAYER_NAMES[1:] if settings.port_index is None else ()
    return names + (("water.index",) if Medium.WATER in media else ()) + bent


def _priors(rig: Rig, views: Sequence[BoardView], mono: bool, settings: CameraSettings) -> dict[str, Prior]:
    """Weak ones keep what a set of images cannot fix from running away; those of glass and water are knowledge."""
    known: dict[str, Prior] = {"water.index": settings.index_prior, **GUESSED_LAYER}
    known |= dict.fromkeys(WARP_NAMES, WARP_PRIOR)
    known["port.distance_m"] = Prior(_START_DISTANCE_M, 0.2)
    known |= {name: Prior(0.0, 0.2) for name in PORT_NAMES[:2]}
    for side, lens in _lenses(rig).items():
        known |= {f"{side}.{key}": Prior(f, 0.5 * f) for key, f in (("fx_px", lens.fx), ("fy_px", lens.fy))}
        centre = ((lens.width - 1) / 2, (lens.height - 1) / 2)
        known |= {
            f"{side}.{key}": Prior(c, 0.25 * lens.width) for key, c in zip(("cx_px", "cy_px"), centre, strict=True)
        }
        known |= {f"{side}.distortion[{i}]": Prior(0.0, sigma) for i, sigma in enumerate(_DISTORTION_SIGMA)}
    return {name: known[name] for name in _names(views, mono, settings) if name in known}


def _finished(fit: Fit, settings: CameraSettings) -> Rig:
    """The fitted rig with its covariance and its water: the colours and the laser's group index go with the fit."""
    count = len(fit.rig_names)
    covariance = RigCovariance(fit.rig_names, fit.covariance[:count, :count])
    rig = dataclasses.replace(fit.rig, covariance=covariance)
    if rig.port is None:
        return rig
    state = settings.water_state
    like = Water.from_state(WaterState(20.0) if state is None else state)
    shift = rig.port.outside_index - like.index
    # dispersion hardly depends on temperature and salt: 2e-4 from fresh to sea water between phase and group index
    water = Water(like.blue + shift, like.green + shift, like.red + shift, like.group_index + shift, state)
    return dataclasses.replace(rig, water=water)
