"""What readings mean in water: scale x group index and offset with honest sigmas, f', and what cannot be told apart."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from laser_scenes import AIR_Z_M, WATER_Z_M, air_rig, lit_points_nees, painted_dive, stations, truth_rig
from leadline.calibration import laser as laser_module
from leadline.calibration.beam_fit import BeamFit, fit_beam
from leadline.calibration.group_index import GROUP, INDEX, with_group_index
from leadline.calibration.laser import LASER, calibrate_laser
from leadline.calibration.range import calibrate_range, range_prior
from leadline.calibration.virtual_focal import virtual_focal
from leadline.errors import InputError
from leadline.paper.pinhole_pair import PinholePair
from leadline.rig import Rig
from leadline.rig_covariance import RigCovariance
from leadline.rig_parameters import get, replaced
from leadline.samples import LaserRange
from leadline.sources import open_source

BENT_RAD = 0.01


def measured_in_air(rig: Rig, rng: np.random.Generator) -> Rig:
    """The rig as it goes under water: true port and water, its laser from spots in air."""
    seen = stations(air_rig(rig), AIR_Z_M, rng)
    start = laser_module._first_beam(dataclasses.replace(air_rig(rig), laser=None), seen, None)
    fit = laser_module._ml_fit(start, seen, rig.covariance)
    return laser_module._brought_home(fit.rig, rig)


def in_water(rig: Rig, true: Rig, rng: np.random.Generator) -> BeamFit:
    return fit_beam(rig, stations(true, WATER_Z_M, rng), (*LASER, GROUP), range_prior(rig))


def true_rig(rng: np.random.Generator) -> Rig:
    """A device of its own scale and offset, whose beam turns at its window and begins anywhere along itself."""
    rig = truth_rig()
    assert rig.laser is not None
    values = get(rig, LASER)
    values[:3] += 0.05 * rng.normal() * rig.laser.direction
    values[6:] += rng.normal(size=2) * [0.01, 0.01]
    return replaced(rig, LASER, values)


def turned(rig: Rig, rng: np.random.Generator) -> Rig:
    direction = get(rig, LASER[3:6]) + BENT_RAD * rng.normal(size=3)
    return replaced(rig, LASER[3:6], direction / np.linalg.norm(direction))


def test_lit_points_are_as_good_as_stated() -> None:
    """20 dives, 6 numbers: mean NEES 1 +- 0.13, wider as the noise is estimated. Twice or half the covariance fails."""
    rng = np.random.default_rng(1)
    values = []
    for _ in range(20):
        dry = true_rig(rng)
        wet = turned(dry, rng)
        values.append(lit_points_nees(in_water(measured_in_air(dry, rng), wet, rng).rig, wet))
    assert 0.65 < np.mean(values) < 1.5


def test_the_dive_shows_where_the_laser_begins() -> None:
    """Together with air: 36 cm of offset a metre. In air alone nobody could say to better than 5 cm."""
    rng = np.random.default_rng(2)
    true = true_rig(rng)
    before = measured_in_air(true, rng)
    after = in_water(before, true, rng)
    assert np.sqrt(np.trace(before.covariance.of(LASER[:3]))) > 0.04
    assert np.sqrt(np.trace(after.rig.covariance.of(LASER[:3]))) < 0.015
    off = get(after.rig, LASER[:3]) - get(true, LASER[:3])
    assert np.linalg.norm(off) < 3 * np.sqrt(np.trace(after.rig.covariance.of(LASER[:3])))


def test_only_the_product_of_scale_and_group_index_is_seen() -> None:
    """A dive that starts from a laser known by its kind only: the product is good, the two alone are not."""
    rng = np.random.default_rng(3)
    rig = dataclasses.replace(truth_rig(), covariance=with_group_index(RigCovariance((INDEX,), np.array([[0.004**2]]))))
    result = in_water(rig, truth_rig(), rng)
    cov = result.rig.covariance.of(("laser.range_scale", GROUP))
    correlation = cov[0, 1] / np.sqrt(cov[0, 0] * cov[1, 1])
    assert correlation < -0.5
    gain = result.rig.laser.range_scale * result.rig.laser.group_index  # type: ignore[union-attr]
    assert abs(gain - 1.004 * 1.35656) < 0.01


def test_the_group_index_follows_the_phase_index() -> None:
    cov = with_group_index(RigCovariance(("left.fx_px", INDEX), np.array([[1.0, 1e-3], [1e-3, 1.6e-5]])))
    block = cov.of((INDEX, GROUP))
    assert block[0, 1] / np.sqrt(block[0, 0] * block[1, 1]) > 0.99
    assert np.sqrt(block[1, 1] / block[0, 0]) == pytest.approx(1.12, rel=0.01)
    assert cov.of(("left.fx_px", GROUP))[0, 1] == pytest.approx(1.12e-3)


def test_virtual_focal_length_is_the_papers() -> None:
    """Equation 12 from perfect stations gives what `leadline.paper` finds with the rig's own beam."""
    quiet = dataclasses.replace(truth_rig(), laser=dataclasses.replace(truth_rig().laser, range_sigma_m=0.0))  # type: ignore[type-var]
    seen = stations(quiet, np.arange(10, 23) / 10, np.random.default_rng(0), sigma_px=0.0)
    focal = virtual_focal(truth_rig(), seen)
    paper = PinholePair(dataclasses.replace(truth_rig(), virtual_focal_px=None))
    assert focal is not None
    assert focal.fx_px == pytest.approx(paper.fx_px, rel=1e-3)
    assert focal.fy_px == pytest.approx(paper.fy_px, rel=1e-3)
    assert focal.scatter_px[0] > 0.5  # one number for all distances is not the truth


def test_what_is_missing_is_told() -> None:
    rig = truth_rig().scaled(0.5)
    dive = list(painted_dive(rig, WATER_Z_M[:3]))
    with pytest.raises(InputError, match="no laser"):
        calibrate_range(dive, dataclasses.replace(rig, laser=None))
    with pytest.raises(InputError, match="no port"):
        calibrate_range(dive, air_rig(rig))
    with pytest.raises(InputError, match="no laser reading"):
        calibrate_range([s for s in dive if not isinstance(s, LaserRange)], rig)
    with pytest.raises(InputError, match="expected in water"):
        calibrate_range(painted_dive(air_rig(rig), AIR_Z_M[:4]), rig)


@pytest.mark.data
def test_rendered_dives_air_then_water(data_dir: Path) -> None:
    """The gate: laser points in water within 2 mm, scale x group index and offset within 3 of their stated sigmas."""
    folder = data_dir / "rendered_dives"
    bare = dataclasses.replace(truth_rig(), laser=None)
    dry = calibrate_laser(open_source(folder / "ranging_air"), bare)
    result = calibrate_range(open_source(folder / "ranging_water"), dry.rig)
    gain, sigma = result.gain
    laser, truth = result.fit.rig.laser, truth_rig().laser
    assert laser is not None
    assert truth is not None
    assert abs(gain - 1.004 * 1.35656) < 3 * sigma
    assert sigma < 0.002
    assert abs(laser.range_offset_m - 0.012) < 3 * result.fit.sigma("laser.range_offset_m")
    assert result.fit.sigma("laser.range_offset_m") < 0.008
    assert result.learnt(GROUP) < 0.1  # it is not seen
    frames = json.loads((folder / "ranging_water" / "truth.json").read_text())["frames"]
    for frame in frames:
        point = laser.point_m(float(np.mean(frame["laser"]["raw_readings_m"])))
        assert np.linalg.norm(point - frame["laser"]["hit_left_m"]) < 0.002
    assert len(result.fit.stations) == len(frames)
    assert result.focal is not None
    assert result.fit.rig.virtual_focal_px == (result.focal.fx_px, result.focal.fy_px)
