"""Is the stated uncertainty true? Simulated calibrations, noise of known size, errors against their covariance.

Long form: 1,000 rigs. Bands are set for 1 % false alarms, and the tests of the tests double and halve the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import chi2

from calibration_scenes import BOARD, SIZE, board_views, random_rig
from leadline.calibration.cameras import CameraSettings, calibrate_cameras
from leadline.calibration.comparison import calibration_sigma_mm, field_points
from leadline.calibration.derivatives import Medium
from leadline.calibration.problem import Problem
from leadline.calibration.views import sights_of
from leadline.rig import Rig
from leadline.rig_parameters import get
from leadline.samples import Array

SIGMA_PX = 0.05
KNOWN_GLASS = CameraSettings(port_thickness_m=0.002, port_index=1.52)
FALSE_ALARM = 0.01


@dataclass(frozen=True, eq=False)
class Run:
    """One calibration: errors (G,) and covariance (G, G) of its parameters, the bound from the true parameters, and the
    depth's error and stated sigma, mm, at the field's points."""

    errors: Array
    covariance: Array
    bound: Array
    depth_error_mm: Array
    depth_sigma_mm: Array


def errors_of(rig: Rig, truth: Rig, names: tuple[str, ...]) -> Array:
    out = get(rig, names) - get(truth, names)
    R = rig.T_right_left.R @ truth.T_right_left.R.T
    turn = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    for i, name in enumerate(names):
        if "rotation_rad" in name:
            out[i] = turn[int(name[-2])]
    return out


def calibrated(seed: int, boards: int) -> Run:
    rng = np.random.default_rng([2026, seed])
    truth = random_rig(rng)
    in_air, poses_air = board_views(truth, Medium.AIR, boards, rng, sigma_px=SIGMA_PX)
    in_water, poses_water = board_views(truth, Medium.WATER, boards, rng, sigma_px=SIGMA_PX)
    calibration = calibrate_cameras(in_air + in_water, BOARD, SIZE, KNOWN_GLASS)
    fit = calibration.fit
    assert len(calibration.views) == 2 * boards
    ideal = Problem(sights_of(in_air + in_water, BOARD), fit.names, calibration.priors)
    bound = np.linalg.inv(ideal.information(truth, poses_air + poses_water, SIGMA_PX))
    points = field_points(truth).reshape(-1, 3)
    found, _ = calibration.rig.triangulate(*truth.project(points))
    sigma, _ = calibration_sigma_mm(calibration.rig, points)
    error = (found - points)[:, 2] * 1e3
    return Run(errors_of(fit.rig, truth, fit.names), fit.covariance, bound, error, sigma)


def nees_in_band(runs: list[Run], factor: float = 1.0) -> bool:
    """The mean of e^T C^-1 e inside its two-sided band; ``factor`` falsifies the covariance."""
    total = sum(float(run.errors @ np.linalg.solve(run.covariance * factor, run.errors)) for run in runs)
    freedom = sum(len(run.errors) for run in runs)
    low, high = chi2.ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2], freedom)
    return bool(low <= total <= high)


def efficiency(runs: list[Run]) -> float:
    """Root mean square error over the Cramer-Rao bound, all parameters together."""
    ratios = [run.errors**2 / np.diag(run.bound) for run in runs]
    return float(np.sqrt(np.mean(np.concatenate(ratios))))


def depth_ratio(runs: list[Run]) -> float:
    """Sampled over predicted standard deviation of the depth, all places and distances together."""
    ratios = np.concatenate([run.depth_error_mm / run.depth_sigma_mm for run in runs])
    return float(np.sqrt(np.nanmean(ratios**2)))


@pytest.fixture(scope="module")
def few() -> list[Run]:
    return [calibrated(seed, 8) for seed in range(16)]


def test_errors_are_as_the_covariance_says(few: list[Run]) -> None:
    assert nees_in_band(few)
    assert not nees_in_band(few, 2.0)
    assert not nees_in_band(few, 0.5)


def test_no_estimator_could_do_much_better(few: list[Run]) -> None:
    assert efficiency(few) < 1.2  # 16 runs: the ratio itself is good to 0.05


def test_depth_sigma_is_the_right_size(few: list[Run]) -> None:
    assert 0.65 < depth_ratio(few) < 1.4  # places share their errors: 16 runs are good to 0.15


@pytest.mark.long
def test_a_thousand_calibrations() -> None:
    runs = [calibrated(1000 + seed, 8) for seed in range(1000)]
    figures = f"RMSE/CRB {efficiency(runs):.4f}, sampled/predicted depth sigma {depth_ratio(runs):.4f}"
    assert nees_in_band(runs), figures
    assert not nees_in_band(runs, 2.0)
    assert not nees_in_band(runs, 0.5)
    assert efficiency(runs) <= 1.1, figures
    assert 0.9 < depth_ratio(runs) < 1.1, figures


def test_25_pairs_each_are_as_good_as_they_can_be() -> None:
    run = calibrated(0, 25)
    truth = random_rig(np.random.default_rng([2026, 0]))
    assert truth.port is not None
    sigma = np.sqrt(np.diag(run.covariance))
    # in the order of the parameters' names: ..., normal x, normal y, distance, index
    tilt, distance, index = sigma[-4:-2], sigma[-2], sigma[-1]
    assert distance <= 3e-4
    assert (np.degrees(tilt) <= 0.012).all()
    assert index <= 2.2e-4
    depth = run.depth_sigma_mm.reshape(-1, 3)
    assert np.nanmax(depth[:, :2]) <= 0.4
    assert np.nanmax(depth[:, 2]) <= 1.1
