"""A beam that cannot be seen: from readings to boards, with a device that lies at short range."""

from __future__ import annotations

import csv
import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest

from calibration_scenes import BOARD, corners, random_pose
from laser_scenes import air_rig
from leadline.calibration.board import Board, find_corners
from leadline.calibration.cameras import calibrate_cameras
from leadline.calibration.laser import LASER
from leadline.calibration.laser_board import BoardReading, calibrate_laser_board, with_laser
from leadline.calibration.views import BoardView
from leadline.errors import InputError
from leadline.geometry import Pose
from leadline.rig_covariance import RigCovariance
from leadline.rig_derivatives import Medium
from leadline.rig_parameters import get, replaced

SIGMA_M = 0.003


def readings(
    rng: np.random.Generator, count: int = 40, *, tilted: bool = True, bias_below_m: float = 0.0
) -> list[BoardReading]:
    """Boards over 0.4-2.4 m, readings along the rendered rig's beam; those below a range are 50 mm short."""
    rig = air_rig()
    beam = rig.laser
    assert beam is not None
    out = []
    for i, z_m in enumerate(np.geomspace(0.4, 2.4, count)):
        pose = random_pose(rng, z_m)
        if not tilted:
            pose = Pose(np.eye(3), [-0.1, -0.1, z_m])
        normal, point = pose.R[:, 2], pose.t_m
        length = float(normal @ (point - beam.origin_m) / (normal @ beam.direction))
        raw = beam.raw_m(length) + SIGMA_M * rng.normal()
        pixels = rig.left.project(pose.apply(BOARD.points_m)) + 0.05 * rng.normal(size=(len(BOARD.points_m), 2))
        out.append(BoardReading(f"{i}.png", corners(pixels), raw - (0.05 if raw < bias_below_m else 0.0)))
    return out


def test_the_beam_is_found_and_its_covariance_is_honest() -> None:
    """25 sets: NEES of the points where it lights, 1 +- 0.14 (5 numbers each; the noise level is estimated from 34)."""
    rng = np.random.default_rng(1)
    values = []
    for _ in range(25):
        fit = calibrate_laser_board(readings(rng), BOARD, air_rig().left)
        truth, found = air_rig().laser, fit.beam
        assert truth is not None
        assert fit.minimum_m is None
        rig = with_laser(air_rig(), fit)

        def points(x: np.ndarray) -> np.ndarray:
            beam = replaced(rig, LASER, x).laser  # noqa: B023
            assert beam is not None
            return np.concatenate([beam.point_m(raw) for raw in (0.6, 2.2)])

        x = get(rig, LASER)
        jacobian = np.stack([(points(x + e) - points(x - e)) / 2e-6 for e in np.eye(8) * 1e-6], axis=1)
        variances, axes = np.linalg.eigh(jacobian @ fit.covariance.matrix @ jacobian.T)
        error = axes.T @ (points(x) - np.concatenate([truth.point_m(raw) for raw in (0.6, 2.2)]))
        values.append(np.mean(error**2 / variances))
        assert np.degrees(np.arccos(min(1.0, found.direction @ truth.direction))) < 1.0
    assert 0.65 < np.mean(values) < 1.5


def test_the_cameras_uncertainty_goes_into_the_beams() -> None:
    """The correlation says what the fit does with a camera that is one sigma off."""
    taken, camera = readings(np.random.default_rng(4)), air_rig().left
    names, sigmas = ("left.fx_px", "left.fy_px", "left.cx_px"), np.array([4.0, 4.0, 3.0])
    known = RigCovariance(names, np.diag(sigmas**2))
    exact = calibrate_laser_board(taken, BOARD, camera)
    fit = calibrate_laser_board(taken, BOARD, camera, known)
    joint = with_laser(dataclasses.replace(air_rig(), covariance=known), fit).covariance
    added = np.zeros((8, 8))
    for name, sigma, field in zip(names, sigmas, ("fx", "fy", "cx"), strict=True):
        off = dataclasses.replace(camera, **{field: getattr(camera, field) + sigma})
        moved = calibrate_laser_board(taken, BOARD, off)
        step = get(with_laser(air_rig(), moved), LASER) - get(with_laser(air_rig(), exact), LASER)
        told = joint.of((*LASER, name))[:8, 8] / sigma
        np.testing.assert_allclose(told, step, atol=0.02 * np.abs(step).max())
        added += np.outer(step, step)
    np.testing.assert_allclose(joint.of(LASER) - exact.covariance.of(LASER), added, atol=0.05 * np.abs(added).max())


def test_readings_below_the_true_minimum_are_found_and_not_averaged_in() -> None:
    fit = calibrate_laser_board(readings(np.random.default_rng(2), bias_below_m=0.6), BOARD, air_rig().left)
    assert fit.minimum_m == pytest.approx(0.62, abs=0.05)
    assert fit.bias_m == pytest.approx(-0.05, abs=0.015)
    assert not fit.used[fit.raw_m < 0.54].any()
    assert fit.rms_m < 0.004


def test_one_blunder_is_left_out_and_named() -> None:
    seen = readings(np.random.default_rng(3))
    seen[30] = BoardReading(seen[30].name, seen[30].corners, seen[30].raw_m + 0.2)
    fit = calibrate_laser_board(seen, BOARD, air_rig().left)
    assert fit.outliers == ("30.png",)
    assert fit.minimum_m is None


def test_boards_that_do_not_fix_the_beam_are_told() -> None:
    with pytest.raises(InputError, match="tilt the board"):
        calibrate_laser_board(readings(np.random.default_rng(4), tilted=False), BOARD, air_rig().left)
    with pytest.raises(InputError, match="8 are needed"):
        calibrate_laser_board(readings(np.random.default_rng(4), 5), BOARD, air_rig().left)


@pytest.mark.data
def test_a_real_rangefinder(data_dir: Path) -> None:
    """Gates: at 0.5 m and more 11 mm rms in the fit and 14 mm on readings not used in it; the bias below is named."""
    folder, board = data_dir / "laser_rangefinder_board_air", Board(8, 6, 0.0387)
    with (folder / "ranges.csv").open() as table:
        rows = [(row["image"], float(row["range_m"])) for row in csv.DictReader(table)]
    seen = []
    for name, raw_m in rows:
        image = cv2.imread(str(folder / "images" / name))
        assert image is not None
        found = find_corners(image, board)
        if found is not None:
            seen.append(BoardReading(name, found, raw_m))
    camera = calibrate_cameras([BoardView(r.name, Medium.AIR, r.corners) for r in seen], board, (640, 480)).rig.left
    fit = calibrate_laser_board(seen, board, camera)
    far = fit.raw_m >= 0.5
    assert fit.used[far].mean() > 0.9
    assert np.sqrt(np.mean(fit.residual_m[fit.used & far] ** 2)) < 0.011
    assert fit.held_out_rms_m < 0.014
    assert fit.minimum_m is not None
    assert 0.3 < fit.minimum_m <= 0.5
    assert -0.07 < fit.bias_m < -0.025
