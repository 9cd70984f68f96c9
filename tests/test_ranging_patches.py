"""Least-squares matching against textures that are moved analytically: no bias, and a sigma that is the real one.

The texture is a sum of plane waves, so that its value at any sub-pixel place is exact and no interpolation stands
between the truth and what is measured.
"""

from __future__ import annotations

import numpy as np
import pytest

from leadline.ranging.images import Float32, Region, doubled, linear
from leadline.ranging.patches import Limits, Matches, Warp, refine, search
from leadline.samples import Array

HALF, SPACING, ROWS, COLUMNS = 9, 26, 12, 22
HEIGHT, WIDTH = SPACING * (ROWS + 2), SPACING * (COLUMNS + 2)
ALONG = np.array([0.96, 0.28])
NOISE = 2.0  # grey levels, in each image


X, Y = np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float)


def texture(x: Array, y: Array) -> Array:
    """Grey levels (H, W) at columns x (W,) and rows y (H,): 60 waves of 7 to 40 px, together some 15 levels strong."""
    rng = np.random.default_rng(1)
    k, turn, phase = 2 * np.pi / rng.uniform(7.0, 40.0, 60), *rng.uniform(0, 2 * np.pi, (2, 60))
    across, down = (np.exp(1j * np.outer(v, k * f(turn))) for v, f in ((x, np.cos), (y, np.sin)))
    return np.asarray(120.0 + 2.7 * ((down * np.exp(1j * phase)) @ across.T).imag)


def pair(shift_px: float, noise: float, seed: int = 2, gain: float = 1.0) -> tuple[Float32, Float32]:
    """Right(q + shift * ALONG) = left(q)."""
    rng = np.random.default_rng(seed)
    left = texture(X, Y)
    right = gain * texture(X - shift_px * ALONG[0], Y - shift_px * ALONG[1]) + 10 * (gain - 1)
    return tuple(np.asarray(i + rng.normal(0, noise, i.shape), np.float32) for i in (left, right))  # type: ignore[return-value]


def flat_warp() -> Warp:
    """Patches a good distance apart, so that each is a sample of its own."""
    v, u = np.mgrid[1 : ROWS + 1, 1 : COLUMNS + 1]
    centre = SPACING * np.stack([u.ravel(), v.ravel()], axis=1).astype(float)
    bend = np.zeros((len(centre), 2, 5))
    bend[:, 0, 0] = bend[:, 1, 1] = 1.0
    return Warp(centre, HALF, centre.copy(), bend, np.tile(ALONG, (len(centre), 1)))


def matched(shift_px: float, start_px: float, noise: float = NOISE, seed: int = 2, gain: float = 1.0) -> Matches:
    """Of all patches, also those with too few features for a verdict: what is tested is the estimate."""
    warp, limits = flat_warp(), Limits(chance=1.0)
    return refine(*pair(shift_px, noise, seed, gain), warp, np.full(len(warp.centre_px), start_px), limits)


def test_exact_without_noise() -> None:
    matches = matched(0.37, 0.0, noise=0.0)
    np.testing.assert_allclose(matches.shift_px, 0.37, atol=0.01)


@pytest.mark.parametrize("shift_px", [-0.5, 0.0, 0.13, 0.37, 0.8])
@pytest.mark.parametrize("gain", [1.0, 0.7])
def test_no_bias_under_noise(shift_px: float, gain: float) -> None:
    """264 patches of 0.02-0.03 px each: the mean is known to 0.002 px."""
    matches = matched(shift_px, 0.0, gain=gain)
    assert np.isfinite(matches.shift_px).mean() > 0.98
    assert abs(np.nanmean(matches.shift_px) - shift_px) < 0.01


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_stated_sigma_is_the_sampled_one(factor: float) -> None:
    """Some 790 patches: their RMS is known to 2.5 %, so 15 % is six sigmas; half or double the sigma is far out."""
    runs = [matched(0.37, 0.0, seed=seed) for seed in (3, 4, 5)]
    off = np.concatenate([run.shift_px - 0.37 for run in runs])
    sigma = factor * np.concatenate([run.sigma_px for run in runs])
    z = (off / sigma)[np.isfinite(off)]
    assert len(z) > 700
    assert (abs(np.sqrt((z**2).mean()) - 1) < 0.15) == (factor == 1.0)


def test_the_start_does_not_matter() -> None:
    here, before, after = (matched(0.37, start).shift_px for start in (0.37, -0.63, 1.37))
    for other in (before, after):
        both = np.isfinite(here) & np.isfinite(other)
        assert both.mean() > 0.95
        assert np.abs(here - other)[both].max() < 0.01


def test_more_noise_more_sigma() -> None:
    quiet, loud = (np.nanmedian(matched(0.2, 0.0, noise=noise).sigma_px) for noise in (1.0, 4.0))
    assert loud == pytest.approx(4 * quiet, rel=0.15)


def test_without_texture_there_is_no_match() -> None:
    """Noise alone has slopes too, but they are not those of the other image."""
    rng = np.random.default_rng(6)
    left, right = (np.asarray(100 + rng.normal(0, NOISE, (HEIGHT, WIDTH)), np.float32) for _ in range(2))
    matches = refine(left, right, flat_warp(), np.zeros(ROWS * COLUMNS))
    assert np.isfinite(matches.shift_px).mean() < 0.01
    even = np.full((HEIGHT, WIDTH), 100.0, np.float32)
    assert np.isnan(refine(even, even, flat_warp(), np.zeros(ROWS * COLUMNS)).shift_px).all()


def test_another_texture_is_no_match() -> None:
    """Three hundred patches of an unrelated place: next to none may be believed."""
    left, right = (np.asarray(texture(X + moved, Y), np.float32) for moved in (0.0, 3000.0))
    matches = refine(left, right, flat_warp(), np.zeros(ROWS * COLUMNS))
    assert np.isfinite(matches.shift_px).mean() < 0.01


@pytest.mark.parametrize("shift_px", [-5.0, 0.0, 3.0])
def test_search_finds_the_place(shift_px: float) -> None:
    left, right = pair(shift_px + 0.2, NOISE)
    found = search(left, right, flat_warp(), 6.0)
    assert np.median(np.abs(found.shift_px - shift_px - 0.2)) < 0.1
    assert (np.abs(found.shift_px - shift_px - 0.2) < 0.5).mean() > 0.99
    assert np.median(found.correlation) > 0.9
    assert found.repeated.mean() < 0.05


def test_slant_is_followed() -> None:
    """A right image stretched by 4 % about each patch: the shift at the patch's centre is still exact."""
    warp = flat_warp()
    stretch, middle = 1.04, warp.centre_px[len(warp.centre_px) // 2]
    left = np.asarray(texture(X, Y), np.float32)
    right = np.asarray(texture(middle[0] + (X - middle[0]) / stretch, Y), np.float32)
    one = Warp(middle[None], HALF, middle[None], warp.bend[:1], np.array([[1.0, 0.0]]))
    assert refine(left, right, one, np.zeros(1)).shift_px == pytest.approx(0.0, abs=0.01)


def test_sampling_is_exact() -> None:
    """Linear on a ramp, where OpenCV 4's tables of 1/32 px show; half pixels on a polynomial of degree 5."""
    rng = np.random.default_rng(7)
    x, y = (rng.uniform(20, 80, (40, 50)).astype(np.float32) for _ in range(2))
    v, u = np.mgrid[0:100, 0:100].astype(np.float32)
    np.testing.assert_allclose(linear(2 * u - v, x, y), 2 * x - y, atol=1e-3)
    at = np.arange(200) / 100 - 1
    down, along = at**5 - at, 1 + at**4
    fine = np.outer(down, along)
    np.testing.assert_allclose(doubled(np.asarray(fine[::2, ::2], np.float32))[8:-8, 8:-8], fine[8:-8, 8:-8], atol=1e-6)


@pytest.mark.parametrize(("wave_px", "most_px"), [(4.0, 0.01), (6.0, 0.003), (12.0, 0.001)])
def test_sampling_moves_no_wave(wave_px: float, most_px: float) -> None:
    """Whole periods sampled at all fractions of a pixel: the wave is where it was (linear at whole pixels: 0.05 px)."""
    k = 2 * np.pi / wave_px
    fine = doubled(np.tile(np.cos(k * np.arange(100.0)), (40, 1)).astype(np.float32))
    x = np.arange(20.0, 80.0) + np.linspace(0, 1, 21)[:, None]
    seen = linear(fine, (2 * x).astype(np.float32), np.full_like(x, 40.0, np.float32))
    moved_px = np.angle((seen * np.exp(-1j * k * x)).sum(axis=1)) / k
    assert np.abs(moved_px).max() < most_px


@pytest.mark.parametrize("level", [0, 1, 2])
def test_a_region_knows_where_it_is(level: int) -> None:
    """A ramp's grey levels are its columns, at any level and wherever the region is cut."""
    ramp = np.tile(np.arange(200, dtype=np.uint8), (120, 1))
    region = Region.of(ramp, level, np.array([37.0, 21.0]), np.array([150.0, 90.0]))
    here = region.to_here(np.array([[101.0, 50.0]]))
    seen = linear(region.grey, *here.T[:, :, None].astype(np.float32))
    assert seen[0, 0] == pytest.approx(101.0, abs=0.6)  # the first halving rounds to whole grey levels
    np.testing.assert_allclose(region.to_full(here), [[101.0, 50.0]])


def test_a_box_beyond_the_image_gives_a_small_region() -> None:
    region = Region.of(np.zeros((120, 200, 3), np.uint8), 2, np.array([900.0, 900.0]), np.array([1000.0, 1000.0]))
    assert min(region.grey.shape) >= 4
