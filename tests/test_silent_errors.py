"""Dives drawn by `benchmarks.silent`, in which things go wrong. Silent: valid, and off by > 5 sigma and 20 mm."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.silent import solve, solve_all_draws
from benchmarks.silent_cases import case


@pytest.mark.parametrize(
    ("number", "largest_m"),
    [
        (252, 0.1),  # a right camera that is knocked by 6 pixels, a rig of the sea: 0.78 m off, 6 solutions silent
        (235, 0.06),  # wrong readings while the pictures are late, and what they left behind: 25 mm
        (242, 0.05),  # exposures 16 ms apart that nobody tells of: 32 mm
    ],
)
def test_dives_that_were_silently_wrong_are_not(number: int, largest_m: float) -> None:
    one = case(number)
    result = solve(one, one.footage())
    assert result.silent_s == ()
    assert np.abs(result.error_m).max() < largest_m
    assert result.frames_valid > 0.9 * result.frames


@pytest.mark.long
def test_no_error_is_silent_in_two_hundred_dives() -> None:
    """Forty dives' pictures with five draws of faults each. 1,000 have been counted: docs/measurements.md."""
    results = [result for number in range(40) for result in solve_all_draws(number, range(5), None)]
    error, sigma = (np.concatenate([getattr(r, name) for r in results]) for name in ("error_m", "sigma_m"))
    assert [r.name for r in results if r.silent_s] == []
    assert np.median(sigma) < 1.5 * np.sqrt(np.mean(error**2))
    assert sum(r.frames_valid for r in results) > 0.75 * sum(r.frames for r in results)
