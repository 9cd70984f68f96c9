"""The layered port: a 50-digit reference, a published pixel, round trips, invariances, Jacobians, unseen points."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from leadline.geometry import Camera, LayeredPort, Pose

LENS = Camera(1400.0, 1400.0, 940.0, 535.0, 1920, 1080)
BENT_LENS = Camera(1401.8, 1400.9, 936.0, 541.7, 1920, 1080, (-0.1656, 0.0012, 2e-4, -1e-4, 0.001))
STACKS = [
    (),
    ((0.002, 1.52),),
    ((0.004, 1.49), (0.0005, 1.33)),
    ((0.002, 1.52), (0.001, 1.0), (0.003, 1.46)),
    ((0.002, 1.52), (0.0005, 1.41), (0.003, 1.46), (0.01, 1.76)),
]


def tilted(degrees: float, around: float = 0.7) -> np.ndarray:
    a = np.radians(degrees)
    return np.array([np.sin(a) * np.cos(around), np.sin(a) * np.sin(around), np.cos(a)])


def turn(axis: np.ndarray, angle: float) -> np.ndarray:
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def points_in_view(port: LayeredPort, lens: Camera, count: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    pixels = rng.uniform((0, 0), (lens.width - 1, lens.height - 1), (count, 2))
    origins, directions = port.rays(lens, pixels)
    return origins + directions * rng.uniform(0.1, 3.0, (count, 1))


def reference_pixel(lens: Camera, port: LayeredPort, point: np.ndarray) -> tuple[mp.mpf, mp.mpf]:
    """Snell's law with angles, solved by bisection with 50 digits: shares no formula with the code under test."""
    with mp.workdps(50):
        n = [mp.mpf(float(v)) for v in port.normal]
        p = [mp.mpf(float(v)) for v in point]
        along = mp.fdot(n, p)
        across = [a - along * b for a, b in zip(p, n, strict=True)]
        r = mp.sqrt(mp.fdot(across, across))
        media = [(mp.mpf(port.distance_m), mp.mpf(1))] + [(mp.mpf(t), mp.mpf(m)) for t, m in port.layers]
        media.append((along - mp.fsum(t for t, _ in media), mp.mpf(port.outside_index)))

        def sideways(theta: mp.mpf) -> mp.mpf:
            return mp.fsum(t * mp.tan(mp.asin(mp.sin(theta) / m)) for t, m in media)

        low, high = mp.mpf(0), mp.pi / 2
        for _ in range(170):
            middle = (low + high) / 2
            low, high = (middle, high) if sideways(middle) < r else (low, middle)
        ray = [mp.cos(low) * a + mp.sin(low) * b / r for a, b in zip(n, across, strict=True)]
        return lens.fx * ray[0] / ray[2] + lens.cx, lens.fy * ray[1] / ray[2] + lens.cy


@pytest.mark.parametrize("layers", STACKS, ids=len)
@pytest.mark.parametrize("degrees", [0, 10, 30])
def test_projection_against_fifty_digits(layers: tuple[tuple[float, float], ...], degrees: float) -> None:
    port = LayeredPort(tilted(degrees), 0.01, layers, 1.335)
    points = points_in_view(port, LENS, 12, seed=len(layers))
    for point, pixel in zip(points, port.project(LENS, points), strict=True):
        u, v = reference_pixel(LENS, port, point)
        assert max(abs(u - mp.mpf(pixel[0])), abs(v - mp.mpf(pixel[1]))) <= 1e-9


def test_published_pixel() -> None:
    """AquaCal's projection (air and water, no glass), also computed with 40 digits."""
    port = LayeredPort((0, 0, 1), 0.05, (), 1.333)
    pixel = port.project(Camera(1400, 1400, 960, 540, 1920, 1080), [[0.8, 0.3, 2.0]])
    np.testing.assert_allclose(pixel, [[1755.6804354, 838.3801633]], atol=1e-6, rtol=0)


@pytest.mark.parametrize("lens", [LENS, BENT_LENS], ids=["straight", "bent"])
@pytest.mark.parametrize("degrees", [0, 3, 30])
@pytest.mark.parametrize("layers", STACKS, ids=len)
def test_rays_lead_back_to_their_pixels(lens: Camera, degrees: float, layers: tuple[tuple[float, float], ...]) -> None:
    port = LayeredPort(tilted(degrees, 2.5), 0.012, layers, 1.34)
    u, v = np.meshgrid(np.linspace(0, 1919, 25), np.linspace(0, 1079, 15))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    origins, directions = port.rays(lens, pixels)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-15)
    np.testing.assert_allclose(origins @ port.normal, port.outer_distance_m, atol=1e-15)
    for length in (0.01, 0.5, 20.0):
        assert np.abs(port.project(lens, origins + length * directions) - pixels).max() <= 1e-9


@pytest.mark.parametrize("lens", [LENS, BENT_LENS], ids=["straight", "bent"])
@pytest.mark.parametrize("degrees", [0, 30])
@pytest.mark.parametrize("layers", STACKS, ids=len)
def test_jacobian_is_the_slope_of_the_projection(
    lens: Camera, degrees: float, layers: tuple[tuple[float, float], ...]
) -> None:
    port = LayeredPort(tilted(degrees), 0.01, layers, 1.335)
    points = points_in_view(port, lens, 60)
    pixels, jacobian = port.project_with_jacobian(lens, points)
    np.testing.assert_allclose(pixels, port.project(lens, points), atol=1e-10)
    h = 1e-6
    slopes = [(port.project(lens, points + h * e) - port.project(lens, points - h * e)) / (2 * h) for e in np.eye(3)]
    np.testing.assert_allclose(jacobian, np.stack(slopes, axis=2), rtol=1e-6, atol=1e-3)


@settings(deadline=None, max_examples=50, derandomize=True, database=None)
@given(st.floats(0, 30), st.floats(0, 6.2), st.floats(0, 0.2), st.floats(0, 0.02), st.floats(-3, 3))
def test_turning_everything_about_the_normal_turns_the_ray(
    degrees: float, around: float, distance_m: float, thickness_m: float, angle: float
) -> None:
    """The port does not know which way is up: turned points are seen by turned rays."""
    normal = tilted(degrees, around)
    port = LayeredPort(normal, distance_m, ((thickness_m, 1.52),), 1.335)
    points = normal * 0.9 + np.array([[0.1, 0.05, 0.0], [-0.08, 0.1, 0.05]])
    R = turn(normal, angle)
    before, after = (LENS.normalise(port.project(LENS, p)) for p in (points, points @ R.T))
    ray = np.concatenate([before, np.ones((2, 1))], axis=1) @ R.T
    np.testing.assert_allclose(after, ray[:, :2] / ray[:, 2:], atol=1e-12)


@settings(deadline=None, max_examples=50, derandomize=True, database=None)
@given(st.floats(0, 40), st.floats(0, 6.2), st.floats(0, 0.1), st.floats(0, 0.05))
def test_without_refraction_it_is_a_pinhole(
    degrees: float, around: float, distance_m: float, thickness_m: float
) -> None:
    port = LayeredPort(tilted(degrees, around), distance_m, ((thickness_m, 1.0),), 1.0)
    points = np.array([[0.3, 0.2, 1.0], [-0.2, 0.1, 2.0], [0.0, 0.0, 0.9]])
    np.testing.assert_allclose(port.project(BENT_LENS, points), BENT_LENS.project(points), atol=1e-9)


@settings(deadline=None, max_examples=50, derandomize=True, database=None)
@given(st.floats(0.0005, 0.02), st.floats(1.3, 1.8), st.floats(0.05, 0.95), st.floats(0, 25))
def test_a_layer_cut_in_two_is_the_same_layer(thickness_m: float, index: float, cut: float, degrees: float) -> None:
    whole = LayeredPort(tilted(degrees), 0.01, ((thickness_m, index),), 1.335)
    halves = ((thickness_m * cut, index), (thickness_m * (1 - cut), index))
    split = LayeredPort(tilted(degrees), 0.01, halves, 1.335)
    points = points_in_view(whole, LENS, 20)
    np.testing.assert_allclose(split.project(LENS, points), whole.project(LENS, points), atol=1e-9)


def test_the_same_port_from_another_camera() -> None:
    """One plane, two cameras: each sees a water ray's points in one line through the same place of the same face."""
    port = LayeredPort(tilted(12), 0.015, ((0.004, 1.49),), 1.34)
    T_right_left = Pose(
        turn(np.array([0.0, 1.0, 0.0]), 0.06) @ turn(np.array([1.0, 0, 0]), -0.03), (-0.063, 0.001, 0.002)
    )
    right = port.seen_from(T_right_left)
    on_face = points_in_view(port, LENS, 30)
    on_face -= np.outer(on_face @ port.normal - port.distance_m, port.normal)
    np.testing.assert_allclose(T_right_left.apply(on_face) @ right.normal, right.distance_m, atol=1e-15)
    back = right.seen_from(T_right_left.inverse())
    np.testing.assert_allclose(back.normal, port.normal, atol=1e-15)
    assert back.distance_m == pytest.approx(port.distance_m, abs=1e-15)


def test_a_camera_outside_its_housing_is_refused() -> None:
    with pytest.raises(ValueError, match="distance_m"):
        LayeredPort((0, 0, 1), 0.01, (), 1.33).seen_from(Pose(np.eye(3), (0, 0, -0.02)))


def test_what_cannot_be_seen_is_nan_and_the_rest_is_not() -> None:
    port = LayeredPort(tilted(20), 0.01, ((0.002, 1.52),), 1.335)
    unseen = [[0, 0, -1], [0, 0, 0.005], [0.0, 0.0, 0.0], [np.nan, 0, 1], [0, np.inf, 1], [3.0, 0.0, -0.5]]
    points = np.array([[0.1, 0.1, 1.0], *unseen, [-0.1, 0.2, 2.0]])
    for seen in (port.project(LENS, points), port.project_with_jacobian(LENS, points)[0]):
        assert np.isfinite(seen).all(axis=1).tolist() == [True, *[False] * len(unseen), True]
    assert np.isnan(port.project_with_jacobian(LENS, points)[1][1:-1]).all()


def test_a_pixel_that_looks_past_the_port_has_no_ray() -> None:
    port = LayeredPort(tilted(80, 0.0), 0.01, (), 1.335)
    origins, directions = port.rays(LENS, [[0.0, 535.0], [1900.0, 535.0], [np.nan, 0.0], [np.inf, 0.0]])
    assert np.isfinite(origins).all(axis=1).tolist() == [False, True, False, False]
    assert np.isfinite(directions).all(axis=1).tolist() == [False, True, False, False]


def test_with_the_pupil_on_the_face_total_reflection_hides_what_lies_aside() -> None:
    """No air before the face: the whole half space is seen within asin(1 / 1.333) = 48.6 degrees of the normal."""
    port = LayeredPort((0, 0, 1), 0.0, (), 1.333)
    tangent = np.tan(np.arcsin(1 / 1.333))
    pixels = port.project(LENS, [[0.99 * tangent, 0, 1.0], [1.01 * tangent, 0, 1.0]])
    assert np.isfinite(pixels).all(axis=1).tolist() == [True, False]


def test_grazing_and_axial_points() -> None:
    """On the normal nothing bends; far to the side light still arrives, nearly along the port."""
    port = LayeredPort((0, 0, 1), 0.05, ((0.01, 1.5),), 1.333)
    np.testing.assert_allclose(port.project(LENS, [[0, 0, 3.0]]), [[LENS.cx, LENS.cy]], atol=1e-12)
    point = np.array([5.0, 0.0, 0.5])
    u, _ = reference_pixel(LENS, port, point)
    assert port.project(LENS, [point])[0, 0] == pytest.approx(float(u), rel=1e-12)


@pytest.mark.parametrize("count", [0, 1, 16384, 16385, 40000])
def test_chunks_join_without_a_seam(count: int) -> None:
    port = LayeredPort((0, 0, 1), 0.01, ((0.002, 1.52),), 1.335)
    points = points_in_view(port, LENS, max(count, 1))[:count]
    pixels, jacobian = port.project_with_jacobian(LENS, points)
    assert pixels.shape == (count, 2)
    assert jacobian.shape == (count, 2, 3)
    assert np.isfinite(jacobian).all()
    if count:
        np.testing.assert_allclose(pixels[-1], port.project(LENS, points[-1:])[0], atol=1e-10)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((0, 0, 1.1), 0.01), "normal"),
        (((0, 0, np.nan), 0.01), "normal"),
        (((0, 0, 1), -0.01), "distance_m"),
        (((0, 0, 1), 0.01, ((-0.002, 1.52),)), r"layers\[0\].thickness_m"),
        (((0, 0, 1), 0.01, ((0.002, 1.5), (0.002, 0.9))), r"layers\[1\].index"),
        (((0, 0, 1), 0.01, (), 0.5), "outside_index"),
    ],
)
def test_a_wrong_port_is_refused_by_name(arguments: tuple[object, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        LayeredPort(*arguments)  # type: ignore[arg-type]
