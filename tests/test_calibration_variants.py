"""Calibrations that are not the plain one: through the port in air, one camera, boards in part or by one camera."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from calibration_scenes import BOARD, SIZE, board_views, random_rig
from leadline.calibration.board import Corners
from leadline.calibration.cameras import CameraCalibration, calibrate_cameras
from leadline.calibration.verdict import best_images, cross_check, verdict
from leadline.calibration.views import BoardView
from leadline.rig import Rig
from leadline.rig_derivatives import Medium

NOISE_PX = 0.05


@pytest.fixture(scope="module")
def truth() -> Rig:
    return random_rig(np.random.default_rng(1))


@pytest.fixture(scope="module")
def views(truth: Rig) -> list[BoardView]:
    rng = np.random.default_rng(11)
    return [v for m in (Medium.AIR_BEHIND_PORT, Medium.WATER) for v in board_views(truth, m, 12, rng)[0]]


def sound(calibration: CameraCalibration, truth: Rig) -> None:
    """All boards are explained by the noise, and the port is where it is, within four sigmas (of 3 parameters)."""
    fit, port = calibration.fit, calibration.rig.port
    assert calibration.left_out == ()
    assert fit.sigma_px == pytest.approx(NOISE_PX, rel=0.06)
    assert port is not None
    assert truth.port is not None
    assert abs(port.distance_m - truth.port.distance_m) < 4 * fit.sigma("port.distance_m")
    assert abs(port.outside_index - truth.port.outside_index) < 4 * fit.sigma("water.index")


def test_air_images_through_the_port(truth: Rig, views: list[BoardView]) -> None:
    sound(calibrate_cameras(views, BOARD, SIZE), truth)


def test_one_camera(truth: Rig, views: list[BoardView]) -> None:
    calibration = calibrate_cameras([dataclasses.replace(v, right=None) for v in views], BOARD, SIZE)
    assert calibration.mono
    sound(calibration, truth)
    assert cross_check(calibration) is None
    assert verdict(calibration, None, best_images(calibration)).next_action


def test_boards_seen_in_part(truth: Rig, views: list[BoardView]) -> None:
    rng = np.random.default_rng(5)

    def part(corners: Corners | None) -> Corners:
        assert corners is not None
        keep = np.sort(rng.choice(len(corners.ids), 50, replace=False))
        return dataclasses.replace(corners, ids=keep, pixels=corners.pixels[keep])

    cut = [dataclasses.replace(v, left=part(v.left), right=part(v.right)) for v in views]
    sound(calibrate_cameras(cut, BOARD, SIZE), truth)


def test_boards_seen_by_one_camera_only(truth: Rig, views: list[BoardView]) -> None:
    some = [
        dataclasses.replace(v, left=v.left if i % 5 else None, right=v.right if i % 7 else None)
        for i, v in enumerate(views)
    ]
    calibration = calibrate_cameras(some, BOARD, SIZE)
    assert len(calibration.views) == len(views) - 1  # the first was seen by neither
    sound(calibration, truth)


def test_single_corners_that_stray_are_left_out(truth: Rig, views: list[BoardView]) -> None:
    first = views[0].left
    assert first is not None
    pixels = first.pixels.copy()
    pixels[10] += 3.0
    bent = [dataclasses.replace(views[0], left=dataclasses.replace(first, pixels=pixels)), *views[1:]]
    calibration = calibrate_cameras(bent, BOARD, SIZE)
    assert calibration.corners_left_out == 1
    sound(calibration, truth)


def test_boards_through_the_port_in_air_alone_fix_no_port(views: list[BoardView]) -> None:
    calibration = calibrate_cameras(views[:12], BOARD, SIZE)
    result = verdict(calibration, cross_check(calibration), None)
    assert not result.good
    assert "in water" in result.next_action
