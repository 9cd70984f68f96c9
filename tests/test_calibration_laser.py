"""The laser from its spots: found without knowing the beam, fitted, with a covariance that has been tested."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest

from laser_scenes import AIR_Z_M, air_rig, lit_points_nees, painted_dive, stations, truth_rig
from leadline.calibration import laser as laser_module
from leadline.calibration.beam_fit import fit_beam
from leadline.calibration.laser import LASER, calibrate_laser, laser_prior
from leadline.calibration.spots import Sighting, sightings, spot_candidates
from leadline.errors import InputError
from leadline.recognition.spot import Spot
from leadline.rig import Rig
from leadline.rig_covariance import RigCovariance
from leadline.rig_parameters import get, replaced
from leadline.samples import LaserRange
from leadline.sources import open_source


def fit(rig: Rig, rng: np.random.Generator, cameras: RigCovariance = RigCovariance()):  # noqa: B008
    """A laser fitted to stations that ``rig`` sees, by a rig that thinks its cameras are the true ones."""
    seen = stations(air_rig(rig), AIR_Z_M, rng)
    start = laser_module._first_beam(dataclasses.replace(air_rig(), laser=None), seen, None)
    return fit_beam(start, seen, LASER, laser_prior(start, cameras))


def nees(rig: Rig, rng: np.random.Generator, cameras: RigCovariance = RigCovariance()) -> float:  # noqa: B008
    return lit_points_nees(fit(rig, rng, cameras).rig, air_rig())


def test_the_covariance_is_honest() -> None:
    """40 fits: mean NEES per dimension is 1 +- 0.09; noise of the estimated noise level widens that. Twice or half the
    covariance gives 0.5 or 2."""
    rng = np.random.default_rng(1)
    mean = float(np.mean([nees(truth_rig(), rng) for _ in range(40)]))
    assert 0.7 < mean < 1.4


def test_uncertain_cameras_go_into_the_lasers_covariance() -> None:
    """The cameras are wrong by what their covariance says; the fit does not know by how much, only how uncertain."""
    rng = np.random.default_rng(2)
    names = ("left.fx_px", "T_right_left.rotation_rad[1]")
    cameras = RigCovariance(names, np.diag([1.0, 3e-4]) ** 2)
    values = []
    for _ in range(30):
        wrong = replaced(truth_rig(), names, get(truth_rig(), names) + rng.normal(size=2) * [1.0, 3e-4])
        values.append(nees(wrong, rng, cameras))
    assert 0.6 < np.mean(values) < 1.5
    blind = np.mean([nees(replaced(truth_rig(), names, [1401.0, 3e-4]), rng) for _ in range(5)])
    assert blind > 5  # without the cameras' covariance it would be far too sure


def test_origin_along_the_beam_and_offset_are_one_number() -> None:
    result = fit(truth_rig(), np.random.default_rng(3))
    cov = result.rig.covariance
    laser = result.rig.laser
    assert laser is not None
    slide = np.concatenate([laser.direction, np.zeros(4), [laser.range_scale]])
    slide /= np.linalg.norm(slide)
    across = np.concatenate([laser.direction, np.zeros(4), [-laser.range_scale]])
    across /= np.linalg.norm(across)
    matrix = cov.of(LASER)
    assert np.sqrt(slide @ matrix @ slide) > 0.04  # nobody can know
    assert np.sqrt(across @ matrix @ across) < 0.004
    here = dataclasses.replace(result.rig, port=None, water=None)
    assert np.sqrt(here.laser_point(1.5)[1][2, 2]) < 0.005  # and where it was measured, it does not matter


def test_a_rig_that_was_in_water_can_be_calibrated_in_air() -> None:
    """What is uncertain of water and port has no part in air, but keeps its place in the rig."""
    names = ("port.distance_m", "water.index", "water.group_index")
    rig = dataclasses.replace(truth_rig(), covariance=RigCovariance(names, np.diag([1e-3, 1e-3, 1e-3]) ** 2))
    for port in ("without", "with"):
        there = laser_module.rig_in_medium(rig, "air", port)
        seen = stations(there, AIR_Z_M, np.random.default_rng(6))
        start = laser_module._first_beam(there, seen, there.laser)
        home = laser_module._brought_home(laser_module._ml_fit(start, seen, rig.covariance).rig, rig)
        assert home.covariance.of(names[1:2])[0, 0] == pytest.approx(1e-6)
        assert home.laser.group_index == rig.laser.group_index  # type: ignore[union-attr]
        through = home.covariance.of((names[0], "laser.origin_m[0]"))[0, 1]
        assert (abs(through) > 0) == (port == "with")


def test_a_station_off_the_beam_is_left_out_and_named() -> None:
    rng = np.random.default_rng(4)
    seen = stations(air_rig(), AIR_Z_M, rng)
    bad = dataclasses.replace(seen[2], raw_m=seen[2].raw_m + 0.05)
    seen[2] = bad
    start = laser_module._first_beam(dataclasses.replace(air_rig(), laser=None), seen, None)
    result = fit_beam(start, seen, LASER, laser_prior(start, RigCovariance()))
    assert [name for name, _ in result.left_out] == [bad.name]
    truth = truth_rig().laser
    assert truth is not None
    assert result.rig.laser is not None
    assert np.linalg.norm(result.rig.laser.direction - truth.direction) < 5e-4


def test_candidates_hold_the_spot_first_even_when_its_core_is_white() -> None:
    """A saturated core is white; corners of a board are brighter edges. Both painted."""
    image = np.full((400, 600, 3), 90, np.uint8)
    cv2.rectangle(image, (100, 100), (300, 300), (200, 200, 200), -1)
    cv2.circle(image, (220 * 16, 190 * 16), 9 * 16, (120, 255, 120), -1, cv2.LINE_AA, 4)
    cv2.circle(image, (220 * 16, 190 * 16), 6 * 16, (255, 255, 255), -1, cv2.LINE_AA, 4)
    first = spot_candidates(image)[0]
    np.testing.assert_allclose(first.q_px, (220, 190), atol=0.1)


@pytest.mark.parametrize("method", ["ml", "paper"])
def test_a_painted_dive_gives_the_laser(method: str) -> None:
    rig = truth_rig()
    truth = dataclasses.replace(air_rig(rig)).laser
    result = calibrate_laser(painted_dive(air_rig(rig), AIR_Z_M), dataclasses.replace(rig, laser=None), method=method)
    laser = result.rig.laser
    assert laser is not None
    assert truth is not None
    assert laser.group_index == rig.water.group_index  # type: ignore[union-attr]
    measured = dataclasses.replace(laser, group_index=1.0)
    for z_m in (0.5, 1.5):
        raw = truth.raw_m(z_m)
        off = 0.002 if method == "ml" else 0.012  # the paper's equations have no scale, and one camera
        assert np.linalg.norm(measured.point_m(raw) - truth.point_m(raw)) < off


def test_a_dive_without_readings_or_spots_or_with_one_distance_is_told() -> None:
    rig = truth_rig().scaled(0.5)
    dive = list(painted_dive(air_rig(rig), AIR_Z_M[:4]))
    with pytest.raises(InputError, match="no laser reading"):
        calibrate_laser([s for s in dive if not isinstance(s, LaserRange)], rig)
    dark = [
        s if isinstance(s, LaserRange) else dataclasses.replace(s, left=s.left * 0, right=s.right * 0) for s in dive
    ]
    with pytest.raises(InputError, match="no spot"):
        calibrate_laser(dark, rig)
    with pytest.raises(InputError, match="one distance"):
        calibrate_laser(painted_dive(air_rig(rig), [1.0, 1.0, 1.0, 1.01]), rig)
    with pytest.raises(InputError, match="no stereo frame"):
        calibrate_laser([s for s in dive if isinstance(s, LaserRange)], rig)
    late = [dataclasses.replace(s, t_ns=s.t_ns + 10**12) if isinstance(s, LaserRange) else s for s in dive]
    with pytest.raises(InputError, match="share one clock"):
        calibrate_laser(late, rig)


def test_the_wrong_medium_is_told() -> None:
    rig = truth_rig().scaled(0.5)
    with pytest.raises(InputError, match=r"a metre where 1\.00 is expected in air"):
        calibrate_laser(painted_dive(rig, AIR_Z_M), rig)
    with pytest.raises(InputError, match="has no port"):
        calibrate_laser(painted_dive(rig, AIR_Z_M), air_rig(rig), medium="water")


def test_corners_that_move_on_straight_lines_are_not_taken_for_a_spot() -> None:
    """Without its spot a board that moves along the axis has many corners that trace lines, with the right readings."""
    rig = truth_rig()
    frames = []
    rng = np.random.default_rng(5)
    for i, z_m in enumerate((0.6, 1.0, 1.4, 1.8, 2.2)):
        grid = np.array([(x, y, z_m) for x in (-0.1, 0.0, 0.1) for y in (-0.05, 0.05)])
        left, right = (q + 0.05 * rng.normal(size=q.shape) for q in air_rig(rig).project(grid))
        raw = 1.004 * z_m + 0.01
        spots = [tuple(Spot(p, 0.01 * np.eye(2), 8.0 + 0.1 * rng.normal()) for p in q) for q in (left, right)]
        frames.append(Sighting(f"{i}.png", spots[0], spots[1], raw, 10, 0.003))
    with pytest.raises(InputError, match="no three"):
        laser_module.find_stations(frames, air_rig(rig), "air")


@pytest.mark.data
def test_rendered_dive_in_air(data_dir: Path) -> None:
    """Spots of another renderer, found without the beam; laser points at all stations within 2 mm of the truth."""
    folder = data_dir / "rendered_dives" / "ranging_air"
    bare = dataclasses.replace(truth_rig(), laser=None)
    result = calibrate_laser(open_source(folder), bare)
    truth, laser = air_rig().laser, dataclasses.replace(result.rig.laser, group_index=1.0)  # type: ignore[type-var]
    assert truth is not None
    assert len(result.stations) == 5
    assert result.pixel_rms < 0.1
    for z_m in (0.5, 1.0, 1.5, 2.0, 2.5):
        raw = truth.raw_m(z_m)
        assert np.linalg.norm(laser.point_m(raw) - truth.point_m(raw)) < 0.002
    # Moved to the true origin along the beam, the offset must be the true one.
    back = (laser.origin_m - truth.origin_m) @ truth.direction
    offset = laser.range_offset_m - laser.range_scale * back
    assert abs(offset - truth.range_offset_m) < 0.003
    assert abs(laser.range_scale - truth.range_scale) < 3 * result.sigma("laser.range_scale")


@pytest.mark.data
def test_a_rendered_board_without_its_spot_gives_no_laser(data_dir: Path) -> None:
    folder = data_dir / "rendered_dives" / "ranging_water"
    dive = list(open_source(folder))[:60]
    found = sightings(without_spot(s) for s in dive)
    with pytest.raises(InputError):
        laser_module.find_stations(found, truth_rig(), "water")


def without_spot(sample):  # type: ignore[no-untyped-def]
    if isinstance(sample, LaserRange):
        return sample
    z_m = 0.5 + 0.01 * round(sample.t_s - 1.5)
    laser = truth_rig().laser
    assert laser is not None
    point = laser.origin_m + (z_m - laser.origin_m[2]) / laser.direction[2] * laser.direction
    sides = {}
    for side, q in zip(("left", "right"), truth_rig().project(point[None]), strict=True):
        image, reach = getattr(sample, side).copy(), int(16 / z_m) + 4
        u, v = np.round(q[0]).astype(int)
        patch = image[v + reach : v + 2 * reach, u - reach : u + reach]
        image[v - reach : v + reach, u - reach : u + reach] = patch.mean(axis=(0, 1))
        sides[side] = image
    return dataclasses.replace(sample, **sides)


def test_a_laser_from_air_does_not_know_the_waters_group_index_better_than_the_water_is_known() -> None:
    """A rig with 0.001 of doubt about its index: 1.1e-3 / 1.36 of every length in water."""
    rig = dataclasses.replace(
        truth_rig(), laser=None, covariance=RigCovariance(("water.index",), np.array([[0.001**2]]))
    )
    found = calibrate_laser(painted_dive(air_rig(), AIR_Z_M[:4]), rig).rig
    assert np.sqrt(found.covariance.of(("water.group_index",))[0, 0]) == pytest.approx(0.00114, rel=0.02)
