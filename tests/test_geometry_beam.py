"""The laser's beam: the range model both ways, its covariance, and a direction that bends at a window."""

from __future__ import annotations

import numpy as np
import pytest

from leadline.geometry import Beam, refract_direction

DIRECTION = np.array([-0.0609878, -0.0259948, 0.9978])
BEAM = Beam((-0.039, 0.088, 0.020), DIRECTION, 1.004, 0.012, 1.35656, range_sigma_m=0.003)


def test_reading_and_length_are_each_other_s_inverse() -> None:
    assert BEAM.raw_m(1.0) == pytest.approx(1.004 * 1.35656 + 0.012)
    assert BEAM.length_m(BEAM.raw_m(0.7)) == pytest.approx(0.7, abs=1e-15)
    np.testing.assert_allclose(BEAM.point_m(BEAM.raw_m(2.0)), BEAM.origin_m + 2.0 * BEAM.direction, atol=1e-15)


def test_point_jacobian_is_the_slope() -> None:
    raw, h = 1.9, 1e-6
    x = np.concatenate([BEAM.origin_m, BEAM.direction, [1.004, 0.012, 1.35656]])

    def point(v: np.ndarray) -> np.ndarray:
        return Beam(v[:3], v[3:6] / np.linalg.norm(v[3:6]), *v[6:]).point_m(raw)

    slopes = [(point(x + h * e) - point(x - h * e)) / (2 * h) for e in np.eye(9)]
    np.testing.assert_allclose(BEAM.point_jacobian(raw), np.stack(slopes, axis=1), atol=1e-8)


def test_covariance_of_a_reading_lies_along_the_beam() -> None:
    cov = BEAM.point_covariance_m2(1.5)
    np.testing.assert_allclose(cov, (0.003 / (1.004 * 1.35656)) ** 2 * np.outer(BEAM.direction, BEAM.direction))


def test_covariance_is_what_sampling_the_parameters_gives() -> None:
    """40,000 samples: an entry's standard error is below 1 % of the largest, the bound is 4 %."""
    rng = np.random.default_rng(7)
    sigma = np.array([0.001, 0.002, 0.001, 0.003, 0.002, 0.001, 0.002, 0.004, 0.001])
    raw, length = 2.1, BEAM.length_m(2.1)
    draws = rng.normal(0, sigma, (40_000, 9))
    direction = BEAM.direction + draws[:, 3:6]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    noise = rng.normal(0, 0.003, 40_000)
    scale, offset, group = 1.004 + draws[:, 6], 0.012 + draws[:, 7], 1.35656 + draws[:, 8]
    lengths = (raw + noise - offset) / (scale * group)
    sampled = np.cov((BEAM.origin_m + draws[:, :3] + lengths[:, None] * direction).T)
    stated = BEAM.point_covariance_m2(raw, np.diag(sigma**2))
    assert length == pytest.approx(lengths.mean(), abs=1e-3)
    assert np.abs(sampled - stated).max() < 0.04 * stated.max()
    assert not np.abs(sampled - 2 * stated).max() < 0.04 * stated.max()


def test_a_beam_square_to_its_window_does_not_bend_and_another_obeys_snell() -> None:
    normal = np.array([0.0, 0.0, 1.0])
    np.testing.assert_allclose(refract_direction(normal, normal, 1.0, 1.34), normal, atol=1e-15)
    a = np.radians(10)
    bent = refract_direction((np.sin(a), 0, np.cos(a)), normal, 1.0, 1.34)
    np.testing.assert_allclose(bent, [np.sin(a) / 1.34, 0, np.sqrt(1 - (np.sin(a) / 1.34) ** 2)], atol=1e-15)
    np.testing.assert_allclose(refract_direction(bent, normal, 1.34, 1.0), [np.sin(a), 0, np.cos(a)], atol=1e-12)


def test_light_that_cannot_leave_the_window_is_refused() -> None:
    with pytest.raises(ValueError, match="totally reflected"):
        refract_direction((np.sin(1.2), 0, np.cos(1.2)), (0, 0, 1), 1.34, 1.0)
    with pytest.raises(ValueError, match="side"):
        refract_direction((0, 0, -1), (0, 0, 1), 1.0, 1.34)


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        ({"direction": (0, 0, 2)}, "direction"),
        ({"origin_m": (0, np.nan, 0)}, "origin_m"),
        ({"range_scale": 0}, "range_scale"),
        ({"range_offset_m": np.inf}, "range_offset_m"),
        ({"group_index": 0.9}, "group_index"),
        ({"range_sigma_m": -1}, "range_sigma_m"),
    ],
)
def test_a_wrong_beam_is_refused_by_name(arguments: dict[str, object], name: str) -> None:
    with pytest.raises(ValueError, match=name):
        Beam(**({"origin_m": (0, 0, 0), "direction": (0, 0, 1)} | arguments))  # type: ignore[arg-type]
