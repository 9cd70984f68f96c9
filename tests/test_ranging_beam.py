"""The beam's two measurements: the reading and the spot, both lengths along one ray."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from leadline.ranging.beam import SIDES, BeamRanger
from leadline.ranging.beam_image import BeamImage
from leadline.rig import Rig, Side
from leadline.rig_covariance import RigCovariance
from leadline.samples import Array, Kind, LaserRange, Measurement, Rejected
from leadline.target import Cylinder, Plane, Sphere, Surface, Target

RIG = Rig.load("rendered")
assert RIG.laser is not None
LASER = RIG.laser
BALL = np.array([-0.05, 0.03, 1.0])
CASES: list[tuple[Target, list[float]]] = [
    (Sphere(0.34), [-0.05, 0.03, 1.0]),
    (Sphere(), [-0.05, 0.03, 1.0, 0.17]),
    (Plane(), [0.05, 0.1, 0.9]),
    (Cylinder(0.5), [-0.05, 0.03, 1.2, 0.1]),
    (Surface(), [-0.02, 0.0, 0.8, 0.02]),
]


def pixels(length_m: float) -> tuple[Array, Array]:
    left, right = RIG.project((LASER.origin_m + length_m * LASER.direction)[None])
    return left[0], right[0]


def length_to(target: Target, x: Array) -> float:
    return float(target.beam_length(x, LASER.origin_m[None], LASER.direction[None])[0][0])


def spot(length_m: float, off_px: tuple[Array, Array] = (np.zeros(2), np.zeros(2)), sigma_px: float = 0.2) -> object:
    cov = sigma_px**2 * np.eye(2)
    left, right = pixels(length_m)
    return BeamRanger(RIG, Sphere(0.34)).spot(7, {"left": (left + off_px[0], cov), "right": (right + off_px[1], cov)})


@pytest.mark.parametrize(("target", "x"), CASES, ids=lambda v: v.name if hasattr(v, "name") else "")
def test_a_reading_predicts_what_the_device_would_say(target: Target, x: list[float]) -> None:
    state = np.array(x)
    measurement = BeamRanger(RIG, target).reading(LaserRange(5, 1.5))
    predicted = measurement.predict(state)
    assert predicted is not None
    value, gradient = predicted
    assert measurement.kind is Kind.LASER
    assert value == pytest.approx([1.004 * 1.35656 * length_to(target, state) + 0.012], abs=1e-4)
    for i, d in enumerate(1e-6 * np.eye(len(state))):
        high, low = (measurement.predict(state + s * d)[0] for s in (1, -1))  # type: ignore[index]
        assert gradient[0, i] == pytest.approx((high[0] - low[0]) / 2e-6, abs=1e-5)


def test_a_reading_carries_the_devices_noise_and_what_the_target_moved() -> None:
    ranger = BeamRanger(RIG, Sphere(0.34))
    gain = LASER.range_scale * LASER.group_index
    assert ranger.reading(LaserRange(5, 1.5)).cov == pytest.approx(np.array([[LASER.range_sigma_m**2]]))
    moved = ranger.reading(LaserRange(5, 1.5), 0.02).cov
    assert moved == pytest.approx(np.array([[LASER.range_sigma_m**2 + (gain * 0.02) ** 2]]))


def test_a_beam_that_passes_by_can_give_no_reading() -> None:
    aside = np.array([0.8, 0.03, 1.0])
    assert BeamRanger(RIG, Sphere(0.34)).reading(LaserRange(5, 1.5)).predict(aside) is None


@pytest.mark.parametrize("length_m", [0.4, 0.8, 1.6, 3.0])
def test_a_spot_is_a_length(length_m: float) -> None:
    found = spot(length_m)
    assert isinstance(found, Measurement)
    assert found.z == pytest.approx([length_m], abs=1e-6)
    ball = LASER.origin_m + (length_m + 0.17) * LASER.direction
    predicted = found.predict(ball)
    assert predicted is not None
    assert predicted[0] == pytest.approx([length_m], abs=1e-9)
    assert predicted[1] @ (1e-5 * LASER.direction) == pytest.approx([1e-5], rel=1e-3)


@pytest.mark.parametrize("sides", [("left",), ("right",), ("left", "right")])
def test_one_image_or_both(sides: tuple[str, ...]) -> None:
    seen = dict(zip(("left", "right"), pixels(1.0), strict=True))
    found = BeamRanger(RIG, Sphere(0.34)).spot(7, {side: (seen[side], 0.04 * np.eye(2)) for side in sides})  # type: ignore[misc]
    assert isinstance(found, Measurement)
    assert found.z == pytest.approx([1.0], abs=1e-6)


def test_stated_sigma_is_the_sampled_one() -> None:
    """400 spots know the RMS of z to 3.5 %. A misfit widens the sigma and never narrows it: chi2 / 3 above 1 is 1.4 on
    average of the wider ones, so that z is somewhat below 1. Half or double the sigma is far outside."""
    rng = np.random.default_rng(1)
    z = []
    for _ in range(400):
        found = spot(1.0, (rng.normal(0, 0.2, 2), rng.normal(0, 0.2, 2)))
        assert isinstance(found, Measurement)
        z.append((found.z[0] - 1.0) / np.sqrt(found.cov[0, 0]))
    rms = np.sqrt(np.mean(np.square(z)))
    for factor in (0.5, 1.0, 2.0):
        assert (0.75 < rms / factor < 1.05) == (factor == 1.0)


def test_a_spot_off_the_beam_is_turned_away() -> None:
    slope = np.array(pixels(1.001)[0]) - pixels(0.999)[0]
    across = np.array([-slope[1], slope[0]]) / np.linalg.norm(slope)
    found = spot(1.0, (5 * across, 5 * across))
    assert isinstance(found, Rejected)
    assert found.reason == "is not on the beam"


def test_two_spots_at_different_lengths_are_turned_away() -> None:
    left, right = pixels(1.0)[0], pixels(1.3)[1]
    seen = {"left": (left, 0.04 * np.eye(2)), "right": (right, 0.04 * np.eye(2))}
    assert isinstance(BeamRanger(RIG, Sphere(0.34)).spot(7, seen), Rejected)  # type: ignore[arg-type]


@pytest.mark.parametrize("side", SIDES)
def test_what_is_sought_is_the_beams_image(side: Side) -> None:
    sought = BeamRanger(RIG, Sphere(0.34)).sought(LASER.origin_m + 1.17 * LASER.direction)
    assert sought is not None
    exact = [pixels(length)[side == "right"] for length in (0.8, 1.0, 1.25)]
    off = [float(np.linalg.norm(sought[side].curve_px - q_px, axis=1).min()) for q_px in exact]
    assert max(off) < 0.8  # half a step between its points
    assert sought[side].curve_px[[0, -1]] == pytest.approx(np.array([exact[0], exact[2]]), abs=1e-3)
    assert np.sqrt(sought[side].shape_px2[0, 0]) == pytest.approx(0.0015 * RIG.focal_outside_px, rel=0.1)


def test_a_beam_that_passes_by_is_not_sought() -> None:
    assert BeamRanger(RIG, Sphere(0.34)).sought(np.array([0.8, 0.03, 1.0])) is None


@pytest.mark.parametrize("side", SIDES)
def test_the_table_of_the_beam_is_exact(side: Side) -> None:
    """Another rig, in other water too: a table is of its rig."""
    assert RIG.port is not None
    salt = dataclasses.replace(RIG, port=dataclasses.replace(RIG.port, outside_index=1.36))
    for rig in (RIG, salt):
        image = BeamImage(rig, side, 0.1, 9.0)
        lengths = 1 / np.linspace(1 / 8.9, 1 / 0.101, 500)
        exact = rig.project(LASER.origin_m + lengths[:, None] * LASER.direction)[side == "right"]
        assert image.at(lengths) == pytest.approx(exact, abs=1e-3)
        *q_px, along_u, along_v = image.near(0.7)
        _, jacobian = rig.project_with_jacobian((LASER.origin_m + 0.7 * LASER.direction)[None], camera=side)
        assert (along_u, along_v) == pytest.approx(jacobian[0] @ LASER.direction, rel=1e-3)
        assert np.array(image.sideways(0.7)) == pytest.approx(jacobian[0] @ image.across.T, rel=0.02, abs=10)
        assert image.closest(np.array(q_px)) == pytest.approx(0.7, rel=0.05)


def test_an_uncertain_rig_gives_an_uncertain_length() -> None:
    """1 mrad of the beam's direction, seen by one camera alone: sampled and stated."""
    names = tuple(f"laser.direction[{i}]" for i in range(3))
    rig = dataclasses.replace(RIG, covariance=RigCovariance(names, 1e-6 * np.eye(3)))
    ranger, rng, off = BeamRanger(rig, Sphere(0.34)), np.random.default_rng(1), []
    for _ in range(300):
        direction = LASER.direction + rng.normal(0, 1e-3, 3)
        point = LASER.origin_m + direction / np.linalg.norm(direction)
        found = ranger.solve({"left": (RIG.project(point[None])[0][0], 1e-4 * np.eye(2))})
        assert found is not None
        off.append((found[0] - 1.0) ** 2 / found[1])
    for factor in (0.5, 1.0, 2.0):  # the mean of 300 is 1 +- 0.08
        assert (0.75 < np.mean(off) / factor < 1.3) == (factor == 1.0), np.mean(off)


@pytest.mark.parametrize("rig_sigma", [0.0, 1e-3])
def test_both_images_and_the_beam_tell_each_spots_place(rig_sigma: float) -> None:
    """Better than either image alone; off the beam's image only as far as the rig may be wrong; honest."""
    names = tuple(f"laser.direction[{i}]" for i in range(3)) if rig_sigma else ()
    rig = dataclasses.replace(RIG, covariance=RigCovariance(names, rig_sigma**2 * np.eye(len(names))))
    ranger, rng = BeamRanger(rig, Sphere(0.34)), np.random.default_rng(4)
    before, after, nees = [], [], []
    for _ in range(200):
        direction = LASER.direction + rng.normal(0, 1, 3) * rig_sigma
        true_px = RIG.project((LASER.origin_m + 1.3 * direction / np.linalg.norm(direction))[None])
        seen = {side: (true_px[i][0] + rng.normal(0, 0.2, 2), 0.04 * np.eye(2)) for i, side in enumerate(SIDES)}
        centres = ranger.centres(seen)
        assert centres is not None
        for i, side in enumerate(SIDES):
            q_px, cov_px2 = centres[side]
            before.append(seen[side][0] - true_px[i][0])
            after.append(q_px - true_px[i][0])
            nees.append(float(after[-1] @ np.linalg.solve(cov_px2 + 1e-8 * np.eye(2), after[-1])))
    gain = np.mean(np.square(after)) / np.mean(np.square(before))
    assert gain < (0.3 if rig_sigma == 0 else 0.8)
    freedom = 1 if rig_sigma == 0 else 2  # on the beam's image it has one
    assert 0.75 * freedom < np.mean(nees) < 1.25 * freedom


def test_a_rig_without_a_laser_has_no_beam() -> None:
    with pytest.raises(ValueError, match="no laser"):
        BeamRanger(dataclasses.replace(RIG, laser=None), Sphere(0.34))
