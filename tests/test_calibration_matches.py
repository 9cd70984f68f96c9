"""Points that both images show: found to a few hundredths of a pixel, and what their rays say of the port."""

from __future__ import annotations

import numpy as np

from laser_scenes import truth_rig
from leadline.calibration.matches import find_matches, misses_px
from leadline.rig_parameters import get, replaced


def seen_points(rng: np.random.Generator, count: int = 60) -> np.ndarray:
    z = rng.uniform(0.5, 2.2, count)
    points = np.stack([z * rng.uniform(-0.3, 0.3, count), z * rng.uniform(-0.2, 0.2, count), z], axis=1)
    return np.hstack(truth_rig().project(points))


def test_true_matches_do_not_miss_each_other_and_a_shift_is_its_number() -> None:
    q = seen_points(np.random.default_rng(1))
    np.testing.assert_allclose(misses_px(truth_rig(), q), 0.0, atol=1e-6)
    moved = q + np.array(
        [0.0, 0.0, 0.0, 0.5]
    )  # the right image half a pixel lower: each camera a quarter, times the root of two
    np.testing.assert_allclose(np.abs(misses_px(truth_rig(), moved)), 0.5 / np.sqrt(2), rtol=0.15)


def test_they_show_a_wrong_port() -> None:
    q, rig = seen_points(np.random.default_rng(2)), truth_rig()
    for name, off, least_px in (
        ("port.normal[0]", 0.005, 0.02),
        ("port.normal[1]", 0.005, 0.02),
        ("port.distance_m", 0.005, 0.01),
    ):
        wrong = replaced(rig, [name], [get(rig, [name])[0] + off])
        assert np.sqrt(np.mean(misses_px(wrong, q) ** 2)) > least_px


def test_texture_is_matched_to_a_few_hundredths_of_a_pixel() -> None:
    """The same random texture, moved by a known fraction of a pixel in the frequency domain."""
    rng = np.random.default_rng(3)
    v, u = np.meshgrid(np.fft.fftfreq(512), np.fft.fftfreq(512), indexing="ij")
    spectrum = np.fft.fft2(rng.normal(size=(512, 512))) * np.exp(-600 * (u**2 + v**2) / 4)
    shift = np.array([-37.4, 1.3])
    images = []
    for at in ((0.0, 0.0), shift):
        texture = np.fft.ifft2(spectrum * np.exp(-2j * np.pi * (u * at[0] + v * at[1]))).real
        noisy = 128 + 40 * texture / texture.std() + rng.normal(size=texture.shape)
        images.append(np.clip(noisy, 0, 255).astype(np.uint8))
    found = find_matches(images[0], images[1], shift + np.array([1.0, -0.8]))
    inside = found[(found[:, 0] > 60) & (found[:, 0] < 480) & (found[:, 1] > 30) & (found[:, 1] < 480)]
    assert len(inside) > 15
    assert np.sqrt(np.mean((inside[:, 2:] - inside[:, :2] - shift) ** 2)) < 0.05


def test_an_image_without_texture_has_no_matches() -> None:
    blank = np.full((200, 300, 3), 90, np.uint8)
    assert find_matches(blank, blank, np.zeros(2)).shape == (0, 4)
    assert misses_px(truth_rig(), np.zeros((0, 4))).shape == (0,)
