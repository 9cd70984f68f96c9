"""A laser dive in water instead of boards: what it adds, and whether its sigmas are honest."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from laser_scenes import AIR_Z_M, WATER_Z_M, air_rig, painted_dive, stations, truth_rig
from leadline.calibration import laser as laser_module
from leadline.calibration.board import Board
from leadline.calibration.cameras import calibrate_cameras
from leadline.calibration.laser import LASER, calibrate_laser
from leadline.calibration.refine import DISTANCES_M, PortGuess, Refinement, depth_sigmas, refine, refine_stations
from leadline.calibration.refine import with_guessed_port as put_in_water
from leadline.errors import InputError
from leadline.geometry import LayeredPort
from leadline.pipeline.calibrate_cameras import find_boards
from leadline.ranging.calibration_error import position_cov
from leadline.rig import Rig
from leadline.rig_covariance import RigCovariance
from leadline.rig_derivatives import Medium
from leadline.rig_parameters import get, replaced
from leadline.sources import open_source
from leadline.water import WaterState

CAMERAS = {"left.fx_px": 0.2, "right.fx_px": 0.2, "T_right_left.t_m[0]": 2e-5, "T_right_left.rotation_rad[1]": 5e-5}
GUESS = PortGuess(distance_m=0.02, distance_sigma_m=0.005)
STATE = WaterState(20.0)
SEEN = ("port.normal[0]", "port.normal[1]", "port.distance_m", "water.index")


def draw(rng: np.random.Generator) -> tuple[Rig, Refinement]:
    """A true rig drawn from what is said to be known, and what a laser in air and in water makes of it."""
    believed = dataclasses.replace(
        air_rig(), laser=None, covariance=RigCovariance(tuple(CAMERAS), np.diag(list(CAMERAS.values())) ** 2)
    )
    rig = replaced(
        truth_rig(), tuple(CAMERAS), get(truth_rig(), tuple(CAMERAS)) + rng.normal(size=4) * list(CAMERAS.values())
    )
    tilt = GUESS.tilt_sigma_rad * rng.normal(size=2)
    index, group = (np.array([1.335045, 1.35656]) + np.array([1.0, 1.12]) * 0.001 * rng.normal()) + [
        0,
        2e-4 * rng.normal(),
    ]
    layer = (GUESS.thickness_m + 3e-4 * rng.normal(), GUESS.index + GUESS.index_sigma * rng.normal())
    distance = GUESS.distance_m + GUESS.distance_sigma_m * np.clip(rng.normal(), -3, 3)
    port = LayeredPort((*tilt, np.sqrt(1 - tilt @ tilt)), distance, (layer,), index)
    values = get(rig, LASER)
    values[:3] += 0.05 * rng.normal() * values[3:6]
    values[6:] += rng.normal(size=2) * [0.005, 0.01]
    rig = replaced(dataclasses.replace(rig, port=port), LASER, values)
    rig = replaced(rig, ["water.group_index"], [group])
    dry = stations(air_rig(rig), AIR_Z_M, rng, sigma_px=0.07)
    start = laser_module._first_beam(believed, dry, None)
    measured = laser_module._ml_fit(start, dry, believed.covariance)
    known = put_in_water(measured.rig, GUESS, STATE)
    return rig, refine_stations(known, stations(rig, WATER_Z_M, rng, sigma_px=0.07, matches=10))


@pytest.fixture(scope="module")
def draws() -> list[tuple[Rig, Refinement]]:
    rng = np.random.default_rng(7)
    return [draw(rng) for _ in range(8)]


def test_the_covariance_is_honest(draws: list[tuple[Rig, Refinement]]) -> None:
    """32 numbers: mean NEES 0.7 +- 0.2. Twice or half the covariance gives 0.35 or 1.4.

    Below 1, since the covariance allows for a beam that turns at its window, which is not drawn here.
    """
    values = []
    for true, refined in draws:
        error = get(refined.rig, SEEN) - get(true, SEEN)
        values.append(error @ np.linalg.solve(refined.rig.covariance.of(SEEN), error) / len(SEEN))
    assert 0.46 < np.mean(values) < 1.3


def test_depth_errors_shrink_and_are_as_stated(draws: list[tuple[Rig, Refinement]]) -> None:
    """Half way out at 2.2 m, where an unknown tilt counts: less than half of the error is left, the cameras' own."""
    before, after, stated = [], [], []
    for true, refined in draws:
        point = np.array([[0.17 * 2.2, 0.0, 2.2]])
        seen = true.project(point)
        before.append(refined.before.triangulate(*seen)[0][0, 2] - 2.2)
        after.append(refined.rig.triangulate(*seen)[0][0, 2] - 2.2)
        stated.append(np.sqrt(position_cov(refined.rig, point[0])[2, 2]))
    rms_before, rms_after = (np.sqrt(np.mean(np.square(e))) for e in (before, after))
    assert rms_after < 0.5 * rms_before
    assert rms_after < 1.7 * np.sqrt(np.mean(np.square(stated)))


def test_a_laser_dive_teaches_the_index_through_its_group_index() -> None:
    """Without the laser's scale from air the index would not be seen."""
    rng = np.random.default_rng(3)
    seen = stations(truth_rig(), WATER_Z_M, rng)
    sigmas = []
    for scale_sigma in (0.0005, 0.1):
        block = np.diag([0.001, 0.001, 0.001, 1e-3, 1e-3, 1e-3, scale_sigma, 0.001]) ** 2
        rig = dataclasses.replace(air_rig(), covariance=RigCovariance(LASER, block))
        refined = refine_stations(put_in_water(rig, PortGuess(0.01, 0.0005), None), seen)
        sigmas.append(refined.fit.sigma("water.index"))
    assert sigmas[0] < 0.35 * 0.004
    assert sigmas[1] > 2 * sigmas[0]


def test_a_beam_that_bends_at_its_window_does_not_fool_it() -> None:
    rng = np.random.default_rng(4)
    block = np.diag([1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 0.001, 0.001]) ** 2
    rig = dataclasses.replace(air_rig(), covariance=RigCovariance(LASER, block))
    bend, aside = np.array([0.02, -0.015, 0.0]), np.array([2e-4, -1.5e-4, 0.0])
    bent = replaced(truth_rig(), LASER[:6], get(truth_rig(), LASER[:6]) + np.concatenate([aside, bend]))
    refined = refine_stations(put_in_water(rig, PortGuess(0.012, 0.003), STATE), stations(bent, WATER_Z_M, rng))
    for name in SEEN:
        off = abs(get(refined.rig, [name])[0] - get(truth_rig(), [name])[0])
        assert off < 3.5 * refined.fit.sigma(name), name


def test_a_rig_without_a_laser_is_told() -> None:
    with pytest.raises(InputError, match="calibrate laser"):
        refine(painted_dive(truth_rig(), WATER_Z_M[:3]), dataclasses.replace(truth_rig(), laser=None))


@pytest.mark.long
@pytest.mark.data
def test_rendered_air_boards_and_one_laser_dive(data_dir: Path) -> None:
    """No board under water, nothing known of port and water: depth good to 1.5 mm, from a guess off by 3 mm."""
    folder, board = data_dir / "rendered_dives", Board(11, 8, 0.030)
    views = find_boards(folder / "calib_air", Medium.AIR, board).views
    cameras = calibrate_cameras(views, board, (1920, 1080)).rig
    dry = calibrate_laser(open_source(folder / "ranging_air"), cameras)
    result = refine(open_source(folder / "ranging_water"), dry.rig)
    z = np.array(DISTANCES_M)
    for slope in (0.0, 0.25, 0.4):
        points = np.stack([slope * z, 0 * z, z], axis=1)
        seen = truth_rig().project(points)
        error = np.abs(result.rig.triangulate(*seen)[0][:, 2] - z)
        guessed = np.abs(result.before.triangulate(*seen)[0][:, 2] - z)
        assert error.max() < 0.0015
        assert guessed.max() > 0.003
    for name in SEEN:
        assert abs(get(result.rig, [name])[0] - get(truth_rig(), [name])[0]) < 3 * result.fit.sigma(name)
    assert (depth_sigmas(result.rig)[:, 0] < 0.6 * depth_sigmas(result.before)[:, 0]).all()
