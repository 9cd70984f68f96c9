"""A laser station's analytic derivatives against differences, in air, in water, and for matches of texture."""

from __future__ import annotations

import numpy as np
import pytest

from laser_scenes import WATER_Z_M, air_rig, spot_points, truth_rig
from leadline.calibration.beam_model import by_length, by_names, expected
from leadline.calibration.group_index import GROUP
from leadline.calibration.laser import LASER
from leadline.calibration.matches import misses_by_names, misses_px
from leadline.calibration.views import LAYER_NAMES, PORT_NAMES, POSE_NAMES, lens_names
from leadline.rig import Rig
from leadline.rig_parameters import get, replaced

RIG_NAMES = (*lens_names("left"), *lens_names("right"), *POSE_NAMES)
WET_NAMES = (*RIG_NAMES, *PORT_NAMES, *LAYER_NAMES, "water.index")


def changed(rig: Rig, name: str, by: float) -> Rig:
    return replaced(rig, [name], [get(rig, [name])[0] + by])


@pytest.mark.parametrize("wet", [True, False])
def test_stations_against_differences(wet: bool) -> None:
    rig = truth_rig() if wet else air_rig()
    rig = replaced(rig, ["T_right_left.rotation_rad[1]", "left.distortion[0]"], [0.02, -0.1])
    names = (*(WET_NAMES if wet else RIG_NAMES), *LASER)
    lengths, _ = spot_points(rig, WATER_Z_M)
    analytic = by_names(rig, lengths, names)
    for i, name in enumerate(names):
        step = 1e-3 if name.endswith("_px") else 1e-6
        up, down = (expected(changed(rig, name, s), lengths) for s in (step, -step))
        difference = (up - down) / (2 * step)
        scale = max(1.0, float(np.abs(difference).max()))
        np.testing.assert_allclose(analytic[:, :, i], difference, atol=2e-5 * scale, err_msg=name)
    up, down = expected(rig, lengths + 1e-5), expected(rig, lengths - 1e-5)
    np.testing.assert_allclose(by_length(rig, lengths), (up - down) / 2e-5, rtol=1e-6, atol=1e-5)


def test_the_group_index_moves_readings_in_water_only() -> None:
    lengths, _ = spot_points(truth_rig(), WATER_Z_M)
    laser = truth_rig().laser
    assert laser is not None
    np.testing.assert_allclose(by_names(truth_rig(), lengths, (GROUP,))[:, 4, 0], laser.range_scale * lengths)
    assert not by_names(air_rig(), lengths, (GROUP, "water.index", "port.distance_m")).any()


def test_matches_against_differences() -> None:
    """Noisy matches, and a rig that is not quite theirs: the second order is what is left."""
    rng = np.random.default_rng(5)
    rig = replaced(truth_rig(), ["T_right_left.rotation_rad[1]", "port.normal[0]"], [0.02, 0.01])
    z = rng.uniform(0.4, 2.2, 40)
    points = np.stack([z * rng.uniform(-0.3, 0.3, 40), z * rng.uniform(-0.2, 0.2, 40), z], axis=1)
    q = np.hstack(rig.project(points)) + 0.05 * rng.normal(size=(40, 4))
    analytic = misses_by_names(rig, q, WET_NAMES)
    for i, name in enumerate(WET_NAMES):
        step = 1e-3 if name.endswith("_px") else 1e-6
        up, down = (misses_px(changed(rig, name, s), q) for s in (step, -step))
        difference = (down - up) / (2 * step)
        scale = max(1.0, float(np.abs(difference).max()))
        np.testing.assert_allclose(analytic[:, i], difference, atol=3e-3 * scale, err_msg=name)
