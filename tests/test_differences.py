"""What differences between laser and cameras are put down to."""

from __future__ import annotations

import numpy as np
import pytest

from leadline.localizer.differences import Difference, biases, clock
from leadline.samples import Array

CLOCK_SIGMA_S = 0.05
NOISE_M = 0.003


def differences(
    speed_m_s: Array, *, scale: float = 0.0, offset_m: float = 0.0, late_s: float = 0.0
) -> list[Difference]:
    """Of an approach from 2.2 m, a reading every 0.4 s, whose speeds are known to 8 mm/s."""
    rng = np.random.default_rng(4)
    length = 2.2 + 0.4 * np.cumsum(speed_m_s)
    metres = offset_m + scale * length + late_s * speed_m_s + rng.normal(0, NOISE_M, len(length))
    seen = speed_m_s + rng.normal(0, 0.008, len(length))
    rows = zip(metres.tolist(), length.tolist(), seen.tolist(), strict=True)
    return [Difference(*row, NOISE_M**2, 1e-8, 0.008**2) for row in rows]


EVEN = np.full(20, -0.25)
UNEVEN = -0.25 + 0.1 * np.sin(np.arange(20))


@pytest.mark.parametrize("count", [6, 10, 15, 20])
def test_other_water_at_an_even_speed_is_no_clock(count: int) -> None:
    """It explains a difference that falls with the distance as well as a clock does whose speed is noise."""
    found = differences(EVEN, scale=-0.011)[:count]
    assert clock(found, 1.0) is None
    if count == 20:
        scale = biases(found, 0.0, CLOCK_SIGMA_S).scale
        assert scale.sigmas > 5
        assert scale.metres == pytest.approx(-0.011 * found[-1].length_m, rel=0.15)


@pytest.mark.parametrize("late_s", [-0.5, 0.5])
def test_a_clock_is_told_where_the_speed_varies(late_s: float) -> None:
    late = clock(differences(UNEVEN, late_s=late_s), 1.0)
    assert late is not None
    assert late[0] == pytest.approx(late_s, abs=0.1)
    assert abs(late[0]) > 5 * late[1]


def test_other_water_is_no_clock_where_the_speed_varies() -> None:
    late = clock(differences(UNEVEN, scale=-0.011), 1.0)
    assert late is not None
    assert abs(late[0]) < max(0.1, 3.5 * late[1])


def test_a_wrong_laser_is_told_at_any_speed() -> None:
    for speed in (EVEN, UNEVEN, np.zeros(20)):
        offset = biases(differences(speed, offset_m=0.1), 0.0, CLOCK_SIGMA_S).offset
        assert offset.metres == pytest.approx(0.1, abs=0.02)
        assert offset.sigmas > 5


def test_nothing_is_told_of_nothing() -> None:
    for speed in (EVEN, UNEVEN, np.zeros(20)):
        assert all(bias.sigmas < 3 for bias in biases(differences(speed), 0.0, CLOCK_SIGMA_S))
