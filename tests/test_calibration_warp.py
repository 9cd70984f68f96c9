"""Boards that are not flat: found to hundredths of a millimetre, named where they are taken for flat.

That the stated uncertainty is true with bent boards too is in ``test_calibration_statistics``.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calibration_scenes import BOARD, SIZE, board_views, random_rig
from leadline.calibration.cameras import CameraCalibration, CameraSettings, calibrate_cameras
from leadline.calibration.comparison import calibration_sigma_mm, field_points
from leadline.calibration.heldout import check_rig
from leadline.calibration.problem import WARP_NAMES
from leadline.calibration.verdict import best_images, cross_check, verdict
from leadline.calibration.warp import warp_of
from leadline.rig import Rig
from leadline.rig_derivatives import Medium
from leadline.samples import Array

FLAT, BENT = CameraSettings(0.002, 1.52), CameraSettings(0.002, 1.52, warp=True)
WARP_M = np.array([6e-4, -3e-4])
COUNT = 10


def calibrated(warp_m: Array, settings: CameraSettings, seed: int = 5) -> tuple[Rig, CameraCalibration]:
    rng = np.random.default_rng([8, seed])
    truth = random_rig(rng)
    views = [v for m in (Medium.AIR, Medium.WATER) for v in board_views(truth, m, COUNT, rng, warp_m=warp_m)[0]]
    return truth, calibrate_cameras(views, BOARD, SIZE, settings)


def depth_off(truth: Rig, calibration: CameraCalibration) -> Array:
    """Depth errors over their stated sigmas, centre and half field."""
    points = field_points(truth)[:, :2].reshape(-1, 3)
    off = calibration.rig.triangulate(*truth.project(points))[0] - points
    return np.asarray(off[:, 2] * 1e3 / calibration_sigma_mm(calibration.rig, points)[0])


def doubts(calibration: CameraCalibration) -> str:
    return "\n".join(verdict(calibration, cross_check(calibration), best_images(calibration)).doubts)


def test_a_bent_board_is_measured_with_the_rest() -> None:
    truth, calibration = calibrated(WARP_M, BENT)
    warp = warp_of(calibration)
    sigma = np.sqrt(np.diag(warp.cov_m2))
    assert (sigma < 1e-5).all()
    assert (np.abs(warp.warp_m - WARP_M) < 4 * sigma).all()
    assert calibration.fit.sigma_px == pytest.approx(0.05, rel=0.06)
    assert np.abs(depth_off(truth, calibration)).max() < 4
    assert "bent" not in doubts(calibration)
    assert not set(WARP_NAMES) & set(calibration.rig.covariance.names)  # the board is no part of the rig


def test_taken_for_flat_it_is_named_and_the_verdict_is_bad() -> None:
    truth, calibration = calibrated(WARP_M, FLAT)
    assert np.abs(depth_off(truth, calibration)).max() > 6  # this is what it would cost
    result = verdict(calibration, cross_check(calibration), None)
    assert not result.good
    assert "the board is bent (+0.59" in doubts(calibration)
    assert result.next_action == "calibrate again with --warp"


@pytest.mark.parametrize("settings", [FLAT, BENT])
def test_a_flat_board_is_compatible_with_zero(settings: CameraSettings) -> None:
    truth, calibration = calibrated(np.zeros(2), settings)
    warp = warp_of(calibration)
    assert not warp.sure
    assert (np.abs(warp.warp_m) < 4 * np.sqrt(np.diag(warp.cov_m2))).all()
    assert "bent" not in doubts(calibration)
    assert np.abs(depth_off(truth, calibration)).max() < 4


def test_a_check_forgives_the_board_but_not_the_rig() -> None:
    truth, _ = calibrated(WARP_M, FLAT)
    views, _ = board_views(truth, Medium.WATER, COUNT, np.random.default_rng(3), warp_m=WARP_M)
    assert check_rig(truth, views, BOARD, SIZE).verdict.good
    assert truth.port is not None
    wrong = dataclasses.replace(truth, port=dataclasses.replace(truth.port, outside_index=1.345))
    assert not check_rig(wrong, views, BOARD, SIZE).verdict.good
