"""Triangulation through the port: exact without noise, and as uncertain as it says."""

from __future__ import annotations

import dataclasses
from itertools import product

import cv2
import numpy as np
import pytest

from leadline.geometry import LayeredPort, Pose, midpoints
from leadline.rig import Rig

SAMPLES = 40_000
SIGMA_PX = 0.1


@pytest.fixture(scope="module")
def rig() -> Rig:
    return Rig.load("rendered")


@pytest.fixture(scope="module")
def skewed() -> Rig:
    """A housing put together carelessly: tilted port, turned and shifted right camera, distorted lenses."""
    rig = Rig.load("paper")
    R = cv2.Rodrigues(np.array([0.01, -0.03, 0.02]))[0]
    port = LayeredPort(np.array([0.12, -0.09, 1]) / np.linalg.norm([0.12, -0.09, 1]), 0.012, ((0.004, 1.49),), 1.34)
    return dataclasses.replace(rig, T_right_left=Pose(R, (-0.0628, 0.0007, -0.0011)), port=port)


def station(rig: Rig, z_m: float, *, corner: bool) -> np.ndarray:
    """The point at distance z on the left camera's axis, or 40 px inside the corner that both cameras see, (1, 3)."""
    pixel = [[rig.left.width - 40.0, 40.0]] if corner else [[(rig.left.width - 1) / 2, (rig.left.height - 1) / 2]]
    origin, direction = rig.rays(pixel)
    return np.asarray(origin + direction * ((z_m - origin[:, 2:]) / direction[:, 2:]))


@pytest.mark.parametrize("name", ["rig", "skewed"])
def test_without_noise_the_point_comes_back(name: str, request: pytest.FixtureRequest) -> None:
    rig = request.getfixturevalue(name)
    points = np.concatenate([station(rig, z, corner=c) for z, c in product((0.2, 0.5, 1.0, 2.2, 5.0), (False, True))])
    found, cov_m2 = rig.triangulate(*rig.project(points))
    np.testing.assert_allclose(found, points, atol=1e-9)
    assert np.all(np.linalg.eigvalsh(cov_m2) > 0)


def agrees(errors_m: np.ndarray, cov_m2: np.ndarray) -> bool:
    """Sampled against stated covariance: every eigenvalue within 10 %, the longest axis within 5 degrees.

    With 40,000 samples an eigenvalue's standard error is 0.7 %, so that a true covariance fails by chance in none of
    1e9 runs.
    """
    sampled, sampled_axes = np.linalg.eigh(np.cov(errors_m.T))
    stated, stated_axes = np.linalg.eigh(cov_m2)
    turned = np.degrees(np.arccos(min(1.0, abs(sampled_axes[:, 2] @ stated_axes[:, 2]))))
    return bool(np.all(abs(sampled / stated - 1) <= 0.10) and turned <= 5)


@pytest.mark.parametrize("z_m", [0.2, 0.5, 1.0, 2.2])
@pytest.mark.parametrize("corner", [False, True], ids=["centre", "corner"])
@pytest.mark.parametrize("name", ["rig", "skewed"])
def test_stated_covariance_is_the_sampled_one(
    name: str, z_m: float, corner: bool, request: pytest.FixtureRequest
) -> None:
    rig = request.getfixturevalue(name)
    point = station(rig, z_m, corner=corner)
    rng = np.random.default_rng(round(z_m * 10) + 100 * corner)
    left, right = (q + rng.normal(0, SIGMA_PX, (SAMPLES, 2)) for q in rig.project(point))
    found, _ = rig.triangulate(left, right, SIGMA_PX)
    _, stated = rig.triangulate(*rig.project(point), SIGMA_PX)
    errors = found - point
    assert np.isfinite(found).all()
    assert agrees(errors, stated[0])
    assert np.abs(errors.mean(axis=0)).max() < 0.05 * np.sqrt(np.trace(stated[0]))
    # the test has teeth: it turns away a covariance twice or half as large
    assert not agrees(errors, 2 * stated[0])
    assert not agrees(errors, stated[0] / 2)


def test_maximum_likelihood_fits_the_pixels_better_than_the_midpoint(rig: Rig) -> None:
    point = station(rig, 0.5, corner=True)
    rng = np.random.default_rng(4)
    left, right = (q + rng.normal(0, 1.0, (500, 2)) for q in rig.project(point))
    best, _ = rig.triangulate(left, right)
    halfway = midpoints(*rig.rays(left, "left"), *rig.rays(right, "right"))

    def misfit(points: np.ndarray) -> np.ndarray:
        return np.asarray(
            sum(((p - q) ** 2).sum(axis=1) for p, q in zip(rig.project(points), (left, right), strict=True))
        )

    assert np.all(misfit(best) <= misfit(halfway) + 1e-9)
    assert misfit(best).mean() < misfit(halfway).mean()
    gradients = []
    for side, q in (("left", left), ("right", right)):
        predicted, jacobian = rig.project_with_jacobian(best, side)  # type: ignore[arg-type]
        gradients.append(np.einsum("nki,nk->ni", jacobian, q - predicted))
    assert np.abs(sum(gradients)).max() < 1e-6 * np.abs(gradients[0]).max()  # at the minimum they cancel
    assert misfit(best).mean() == pytest.approx(1.0, abs=0.2)  # four pixels less three coordinates leave one freedom


def test_sigma_scales_the_covariance_for_each_point(rig: Rig) -> None:
    points = np.repeat(station(rig, 1.0, corner=False), 3, axis=0)
    _, unit = rig.triangulate(*rig.project(points), 1.0)
    _, each = rig.triangulate(*rig.project(points), np.array([0.1, 0.5, 2.0]))
    np.testing.assert_allclose(each, unit * np.array([0.01, 0.25, 4.0])[:, None, None], rtol=1e-12)


def test_unequal_numbers_of_pixels_are_refused(rig: Rig) -> None:
    """One right pixel was spread over all left ones."""
    left, right = rig.project(np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.5], [0.0, 0.1, 2.0]]))
    with pytest.raises(ValueError, match=r"left_px \(2, 2\) and right_px \(1, 2\)"):
        rig.triangulate(left[:2], right[:1])


@pytest.mark.parametrize("sigma_px", [-1.0, np.nan, [0.1, 0.1], [0.1, -0.1, 0.1]])
def test_a_sigma_that_is_none_is_refused(rig: Rig, sigma_px: float | list[float]) -> None:
    points = np.repeat(station(rig, 1.0, corner=False), 3, axis=0)
    with pytest.raises(ValueError, match="sigma_px: must be 0 or more, one number or one for each of 3 points"):
        rig.triangulate(*rig.project(points), sigma_px)


def test_pixels_that_do_not_meet_are_nan_and_the_others_are_not(rig: Rig) -> None:
    left, right = rig.project(np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.5], [0.0, 0.1, 2.0]]))
    left[0, 0] -= 500.0  # now the rays part
    left[1, 0] = np.nan
    found, cov_m2 = rig.triangulate(left, right)
    assert np.isfinite(found).all(axis=1).tolist() == [False, False, True]
    assert np.isfinite(cov_m2).all(axis=(1, 2)).tolist() == [False, False, True]


def test_parallel_rays_meet_nowhere(rig: Rig) -> None:
    air = dataclasses.replace(rig, port=None, water=None)
    found, cov_m2 = air.triangulate([[940.0, 535.0]], [[940.0, 535.0]])
    assert np.isnan(found).all()
    assert np.isnan(cov_m2).all()


def test_in_air_it_agrees_with_opencv() -> None:
    rig = Rig.load("rendered")
    air = dataclasses.replace(rig, port=None, water=None)
    points = np.random.default_rng(0).uniform((-1, -0.6, 2), (1, 0.6, 15), (50, 3))
    left, right = air.project(points)
    P = np.hstack([air.left.matrix, np.zeros((3, 1))])
    Q = air.right.matrix @ np.hstack([air.T_right_left.R, air.T_right_left.t_m[:, None]])
    theirs = cv2.triangulatePoints(P, Q, left.T, right.T)
    found, _ = air.triangulate(left, right)
    np.testing.assert_allclose(found, (theirs[:3] / theirs[3]).T, rtol=1e-6)
