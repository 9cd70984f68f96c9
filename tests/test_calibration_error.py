"""The calibration's part of a point's covariance: predicted = sampled, and quick enough for every frame."""

from __future__ import annotations

import dataclasses
import time

import numpy as np
import pytest

from leadline.ranging.calibration_error import CalibrationError, beam_cov, position_cov
from leadline.rig import Rig
from leadline.rig_covariance import RigCovariance
from leadline.rig_parameters import get, replaced

SIGMAS = {
    "left.fx_px": 0.3,
    "left.cx_px": 0.4,
    "right.cx_px": 0.4,
    "T_right_left.t_m[0]": 2e-5,
    "T_right_left.rotation_rad[1]": 1e-4,
    "port.distance_m": 5e-4,
    "port.normal[0]": 5e-4,
    "water.index": 5e-4,
    "laser.origin_m[0]": 1e-4,
    "laser.direction[1]": 2e-4,
    "laser.range_offset_m": 1e-3,
}
POINT = (0.15, -0.1, 1.3)


def uncertain_rig() -> Rig:
    rng = np.random.default_rng(4)
    sigma = np.array(list(SIGMAS.values()))
    mixed = np.eye(len(sigma)) + 0.4 * rng.normal(size=(len(sigma), len(sigma))) / np.sqrt(len(sigma))
    matrix = (mixed @ mixed.T) * np.outer(sigma, sigma)
    return dataclasses.replace(Rig.load("rendered"), covariance=RigCovariance(tuple(SIGMAS), (matrix + matrix.T) / 2))


def sampled(rig: Rig, count: int = 500) -> np.ndarray:
    """Wrong rigs, drawn from the covariance, triangulate the pixels that the true one gives."""
    rng = np.random.default_rng(5)
    names = rig.covariance.names
    left, right = rig.project(np.array([POINT]))
    errors = rng.multivariate_normal(np.zeros(len(names)), rig.covariance.matrix, count)
    points = [replaced(rig, names, get(rig, names) + e).triangulate(left, right)[0][0] for e in errors]
    return np.cov(np.array(points).T)


def test_predicted_equals_sampled() -> None:
    """500 samples: a variance scatters by 6.3 %; 25 % is four sigmas, and doubling or halving is far outside."""
    rig = uncertain_rig()
    predicted, seen = position_cov(rig, POINT), sampled(rig)
    np.testing.assert_allclose(np.linalg.eigvalsh(predicted), np.linalg.eigvalsh(seen), rtol=0.25)
    np.testing.assert_allclose(predicted, seen, atol=0.25 * np.trace(seen))


@pytest.mark.parametrize("point", [POINT, (0.0, 0.0, 0.2), (0.4, 0.2, 1.0), (-0.9, 0.5, 2.2), (0.02, 0.01, 4.0)])
def test_the_table_gives_what_the_definition_gives(point: tuple[float, float, float]) -> None:
    rig = uncertain_rig()
    predicted, table = position_cov(rig, point), CalibrationError(rig).at(point)
    np.testing.assert_allclose(np.sqrt(np.diag(table)), np.sqrt(np.diag(predicted)), rtol=0.03, atol=1e-6)


def test_quick_enough_for_every_frame() -> None:
    error = CalibrationError(uncertain_rig())
    times = []
    for _ in range(20):
        start = time.process_time()
        error.at(POINT)
        times.append(time.process_time() - start)
    assert min(times) < 3e-4


def test_an_exact_rig_adds_nothing() -> None:
    rig = Rig.load("rendered")
    assert not position_cov(rig, POINT).any()
    assert not CalibrationError(rig).at(POINT).any()
    assert not beam_cov(rig, 1.0).any()


def test_a_point_outside_the_field_takes_the_nearest_place() -> None:
    error = CalibrationError(uncertain_rig())
    far_out = error.at((9.0, 0.0, 1.0))
    assert np.isfinite(far_out).all()
    assert np.isfinite(error.at((0.0, 0.0, 0.001))).all()
    assert np.linalg.eigvalsh(far_out)[0] >= -1e-15


def test_the_beams_part_has_no_reading_noise() -> None:
    rig = uncertain_rig()
    with_noise = rig.laser_point(1.5)[1]
    assert rig.laser is not None
    along = rig.laser.direction
    noise = along @ (with_noise - beam_cov(rig, 1.5)) @ along
    assert np.sqrt(noise) == pytest.approx(rig.laser.length_sigma_m, rel=1e-6)
    with pytest.raises(ValueError, match="no laser"):
        beam_cov(dataclasses.replace(rig, laser=None), 1.0)
