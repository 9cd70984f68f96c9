"""Laser against cameras: a pool's rig in the sea (the other way round: test_localizer_honest)."""

from __future__ import annotations

import dataclasses

import numpy as np

from leadline.config import Config
from leadline.localizer import Localizer
from leadline.localizer.agreement import Agreement, Length
from leadline.localizer.laser import LaserSight
from leadline.ranging.calibration_error import CalibrationError
from leadline.rig import Rig
from leadline.samples import NS_PER_S, Array, Kind, Measurement
from leadline.simulation.dive import SimulatedDive
from leadline.simulation.scenario import Scenario
from leadline.target import Sphere, Surface
from leadline.water import Water, WaterState
from short_dives import TrueBoxes, range_errors, samples


def sea_dive() -> SimulatedDive:
    """A dive in sea water, of the demo's ball from 1.3 to 0.5 m."""
    demo = Scenario.load("demo")
    way = {"start_m": 1.3, "end_m": 0.5, "speed_m_s": 0.16, "dwell_s": 0.0}
    parts = {
        "path": demo.path.model_copy(update=way),
        "camera": demo.camera.model_copy(update={"rate_hz": 8.0, "image_width_px": 320}),
    }
    sea = Rig.load(demo.rig).in_water(Water.from_state(WaterState(20.0, 35.0), 532.0))
    return SimulatedDive(demo.model_copy(update=parts), 5, sea)


def solve(dive: SimulatedDive, rig: Rig) -> tuple[Array, Array, str]:
    """Range errors and stated sigmas (N,), m, and what was told."""
    localizer = Localizer(rig, Sphere(0.34), TrueBoxes(dive))
    solutions = [s for s in map(localizer.step, samples(dive)) if s is not None]
    return *range_errors(solutions, dive), " ".join(localizer.notices)


def test_a_rig_for_a_pool_in_the_sea_is_told_and_covered() -> None:
    dive = sea_dive()
    pool = dive.rig.in_water(Water.from_state(WaterState(20.0, 0.0), 532.0))
    right, right_sigma, nothing = solve(dive, dive.rig)
    wrong, sigma, told = solve(dive, pool)
    assert nothing == ""
    assert "is the water state right" in told
    assert not ((np.abs(wrong) > 5 * sigma) & (np.abs(wrong) > 0.020)).any()
    assert np.abs(wrong).mean() > 3 * np.abs(right).mean()  # it does matter
    late = np.arange(len(wrong)) > len(wrong) / 2
    assert (np.abs(wrong[late]) < 2 * sigma[late]).mean() > 0.95
    assert np.median(sigma) > 4 * np.median(right_sigma)


def test_how_far_behind_an_unknown_surface_the_beam_goes_is_one_error_of_all_frames() -> None:
    """Tens of frames that share it do not make it small: a lump 3 m away is no laser at fault."""
    rig = Rig.load("rendered")
    sight = LaserSight(rig, Surface(), Config())
    cov = np.diag([1e-4, 1e-4, 4e-4, 0.12**2])
    seen = Measurement(Kind.STEREO, 0, np.array([0.0, 0.0, 3.0, 0.0]), cov, lambda x: None)
    by_camera = sight.length_by(seen, CalibrationError(rig))
    assert by_camera is not None
    assert 0.01 < by_camera.variance_m2**0.5 < 0.03
    assert by_camera.shape_m2**0.5 > 0.119
    agreement = Agreement()
    spot = Length(0, by_camera.length_m + 0.15, 1e-6, by_camera.common_m2)
    for i in range(60):
        t_ns = i * NS_PER_S // 10
        agreement.see(dataclasses.replace(by_camera, t_ns=t_ns))
        agreement.check(spot, by_camera)
        agreement.read(Length(t_ns - NS_PER_S // 20, by_camera.length_m + 0.15, 1e-6, 1e-6), None)
    assert not agreement.notices
