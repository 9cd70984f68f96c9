"""Pinhole, lens distortion, poses: OpenCV as the oracle, round trips, Jacobians."""

from __future__ import annotations

import pickle

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from leadline.geometry import Camera, Pose

LENSES = {
    0: (),
    4: (-0.1656, 0.0012, 3e-4, -2e-4),
    5: (-0.28, 0.09, 5e-4, -3e-4, -0.012),
    8: (0.35, -0.12, 2e-4, -1e-4, 0.01, 0.6, -0.1, 0.02),
    12: (0.35, -0.12, 2e-4, -1e-4, 0.01, 0.6, -0.1, 0.02, 1e-3, -4e-4, -8e-4, 3e-4),
}


def camera(count: int) -> Camera:
    return Camera(1402.0, 1398.0, 936.5, 541.2, 1920, 1080, LENSES[count])


def image_grid(lens: Camera, step: int = 60) -> np.ndarray:
    u, v = np.meshgrid(np.arange(0, lens.width, step), np.arange(0, lens.height, step))
    return np.stack([u.ravel(), v.ravel()], axis=1).astype(float)


@pytest.mark.parametrize("count", LENSES)
def test_projects_as_opencv_does(count: int) -> None:
    lens = camera(count)
    points = np.random.default_rng(count).uniform((-0.6, -0.35, 1), (0.6, 0.35, 1), (500, 3)) * 1.7
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), lens.matrix, np.array(LENSES[count] or [0.0] * 4))
    np.testing.assert_allclose(lens.project(points), theirs[:, 0], atol=1e-9, rtol=0)


@pytest.mark.parametrize("count", LENSES)
def test_round_trip_over_the_whole_image(count: int) -> None:
    lens = camera(count)
    pixels = image_grid(lens)
    assert np.abs(lens.pixels(lens.normalise(pixels)) - pixels).max() <= 1e-9


@pytest.mark.parametrize("count", LENSES)
def test_jacobian_is_the_slope_of_the_projection(count: int) -> None:
    lens = camera(count)
    points = np.random.default_rng(1).uniform((-0.5, -0.3, 0.9), (0.5, 0.3, 1.1), (50, 3))
    pixels, jacobian = lens.project_with_jacobian(points)
    np.testing.assert_array_equal(pixels, lens.project(points))
    h = 1e-5
    slopes = [(lens.project(points + h * e) - lens.project(points - h * e)) / (2 * h) for e in np.eye(3)]
    np.testing.assert_allclose(jacobian, np.stack(slopes, axis=2), rtol=1e-6, atol=1e-4)


def test_what_cannot_be_seen_is_nan_and_the_rest_is_not() -> None:
    points = np.array([[0.1, 0, 1], [0.1, 0, -1], [0.1, 0, 0], [np.nan, 0, 1], [np.inf, 0, 1], [0, 0, 2]])
    seen = np.isfinite(camera(4).project(points)).all(axis=1)
    assert seen.tolist() == [True, False, False, False, False, True]


def test_a_point_beyond_the_lens_s_field_does_not_fold_back_into_the_image() -> None:
    """r (1 - 0.1656 r^2) turns back at r = 1.42; a point 67 degrees off the axis would show up near the centre."""
    lens = camera(4)
    far_off = np.array([[2.4, 0.0, 1.0]])
    theirs, _ = cv2.projectPoints(far_off, np.zeros(3), np.zeros(3), lens.matrix, np.array(LENSES[4]))
    assert 0 < theirs[0, 0, 0] < lens.width
    assert np.isnan(lens.project(far_off)).all()
    assert np.sqrt(lens.fold_r2) == pytest.approx(1.42, abs=0.02)


def test_a_pixel_that_no_ray_reaches_is_nan() -> None:
    assert np.isnan(camera(4).normalise([[9000.0, 0.0], [960.0, 540.0]])).any(axis=1).tolist() == [True, False]


def test_empty_in_empty_out() -> None:
    lens = camera(5)
    assert lens.project(np.empty((0, 3))).shape == (0, 2)
    assert lens.normalise(np.empty((0, 2))).shape == (0, 2)
    assert lens.project_with_jacobian(np.empty((0, 3)))[1].shape == (0, 2, 3)


def test_scaling_keeps_pixel_centres_in_place() -> None:
    """Half size: pixel 0 and 1 become one pixel whose centre, at 0.5 of the old ones, is the new 0."""
    half = camera(4).scaled(0.5)
    points = np.array([[0.2, 0.1, 1.0], [-0.3, 0.2, 2.0]])
    np.testing.assert_allclose(half.project(points), (camera(4).project(points) + 0.5) / 2 - 0.5, atol=1e-12)
    assert (half.width, half.height) == (960, 540)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fx": 0.0}, "fx"),
        ({"fy": np.nan}, "fy"),
        ({"cx": np.inf}, "cx"),
        ({"cy": 10**400}, "cy: must be finite"),
        ({"width": 0}, "width"),
        ({"distortion": (0.1, 0.2)}, "distortion"),
        ({"distortion": (0.1, np.nan, 0, 0)}, "distortion"),
    ],
)
def test_a_wrong_camera_is_refused_by_name(change: dict[str, object], message: str) -> None:
    good = {"fx": 1400.0, "fy": 1400.0, "cx": 960.0, "cy": 540.0, "width": 1920, "height": 1080}
    with pytest.raises(ValueError, match=message):
        Camera(**(good | change))  # type: ignore[arg-type]


def test_arrays_of_another_shape_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\(N, 3\)"):
        camera(0).project([0.0, 0.0, 1.0])


rotations = st.tuples(*[st.floats(-3, 3)] * 3).map(lambda r: cv2.Rodrigues(np.array(r))[0])
vectors = st.tuples(*[st.floats(-5, 5)] * 3).map(np.array)


@settings(deadline=None, max_examples=60, derandomize=True, database=None)
@given(rotations, vectors, rotations, vectors, vectors)
def test_poses_compose_and_invert(R: np.ndarray, t: np.ndarray, Q: np.ndarray, s: np.ndarray, p: np.ndarray) -> None:
    T_b_a, T_c_b = Pose(R, t), Pose(Q, s)
    np.testing.assert_allclose(T_b_a.inverse().apply(T_b_a.apply(p)), p, atol=1e-12)
    np.testing.assert_allclose((T_c_b @ T_b_a).apply(p), T_c_b.apply(T_b_a.apply(p)), atol=1e-12)
    assert np.linalg.norm(T_b_a.rotate(p)) == pytest.approx(np.linalg.norm(p), abs=1e-12)


def test_a_rounded_rotation_becomes_a_true_one_and_another_matrix_is_refused() -> None:
    R = cv2.Rodrigues(np.array([0.3, -0.2, 0.5]))[0]
    mended = Pose(np.round(R, 4), (0, 0, 0)).R
    np.testing.assert_allclose(mended @ mended.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(mended, R, atol=1e-4)
    for wrong in (np.diag([1, 1, -1]), 1.01 * R, np.full((3, 3), np.nan), np.eye(2)):
        with pytest.raises(ValueError, match="R: "):
            Pose(wrong, (0, 0, 0))


def test_values_do_not_change_and_pickle() -> None:
    pose = Pose(np.eye(3), (1, 2, 3))
    with pytest.raises(ValueError, match="read-only"):
        pose.t_m[0] = 5
    again = pickle.loads(pickle.dumps(pose))
    np.testing.assert_array_equal(again.t_m, pose.t_m)
    assert pickle.loads(pickle.dumps(camera(8))) == camera(8)
