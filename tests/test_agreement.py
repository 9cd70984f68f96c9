"""Laser against cameras: a pool's rig in the sea (the other way round: test_localizer_honest)."""

from __future__ import annotations

import numpy as np

from leadline.localizer import Localizer
from leadline.rig import Rig
from leadline.samples import Array
from leadline.simulation.dive import SimulatedDive
from leadline.simulation.scenario import Scenario
from leadline.target import Sphere
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
