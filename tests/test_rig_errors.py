"""A calibration's error is one error of all frames: it stays in the stated covariance, however many frames there are.

For every approach the true rig is drawn from the covariance of the believed one (``drawn_rigs``), and so are the errors
of matching and outline. The normalised squared error (NEES) of the position would be 3 on average, were the stated
covariance exactly that of the errors. It is a bound: above 3 the localizer is too sure of itself, and there the test is
strict (the mean of N squares has the standard deviation sqrt(6 / N); false alarms: one in a hundred). Below 3 it is too
careful: a calibration's error widens every measurement, so that no sensor is turned away for it, and is added to what
the filter says besides, since frames do not average it; the part that the filter has kept counts twice.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy import stats

from drawn_rigs import Approach
from leadline.samples import Array

FALSE_ALARM = 0.01
LEAST = 1.0  # of 3: a covariance that is three times too large says nothing
READING_EVERY = 3  # frames
NEAREST_M, FARTHEST_M = 0.25, 2.2


@cache
def nees(approaches: int, frames: int, *, exact: bool = False) -> Array:
    """(approaches, frames). exact: the localizer does not know that its rig has errors."""
    table = np.full((approaches, frames), np.nan)
    for seed in range(approaches):
        rng = np.random.default_rng((31, seed))
        distance_m = float(np.exp(rng.uniform(np.log(NEAREST_M), np.log(FARTHEST_M))))
        approach = Approach(seed, distance_m, frames)
        localizer = approach.localizer(exact=exact)
        for i, t_ns in enumerate(approach.times_ns):
            reading = approach.readings[t_ns]
            if reading is not None and i % READING_EVERY == 0:
                localizer.step(reading)
            solution = localizer.step(approach.frame(t_ns))
            assert solution is not None
            if solution.position_m is not None and solution.cov_m2 is not None:
                off = solution.position_m - approach.at(t_ns)
                table[seed, i] = off @ np.linalg.solve(solution.cov_m2, off)
    return table


def too_sure(values: Array) -> bool:
    """Of one frame of every approach (N,): their sum is chi-square with 3 N degrees of freedom, if all is as stated."""
    return bool(values.sum() > stats.chi2.ppf(1 - FALSE_ALARM, 3 * len(values)))


def check(approaches: int, frames: int) -> None:
    table = nees(approaches, frames)
    assert np.isfinite(table).all()
    told = f"NEES of 3, by frame: {np.round(table.mean(axis=0), 2)}"
    assert not too_sure(table[:, 0]), told
    assert not too_sure(table[:, -1]), told
    assert table[:, -1].mean() > LEAST, told


def test_the_error_of_a_rig_is_in_the_stated_covariance_after_many_frames() -> None:
    check(10, 8)


def test_a_localizer_that_takes_its_rig_for_exact_is_found_out() -> None:
    values = nees(4, 8, exact=True)
    assert too_sure(values[:, -1])


@pytest.mark.long
def test_the_error_of_a_rig_is_in_the_stated_covariance_of_two_hundred_approaches() -> None:
    check(200, 40)
