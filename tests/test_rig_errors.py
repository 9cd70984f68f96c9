"""A calibration's error is one error of all frames: it stays in the stated covariance, however many frames there are.

For every approach the true rig is drawn from the covariance of the believed one (``drawn_rigs``), and so are the errors
of matching and outline. The normalised squared error (NEES) of the position would be 3 on average, were the stated
covariance exactly that of the errors. It is a bound: above 3 the localizer is too sure of itself, and there the test is
strict (the mean of N squares has the standard deviation sqrt(6 / N); false alarms: one in a hundred). A calibration's
error widens every measurement, so that no sensor is turned away for it, and is added to what the filter says besides,
since frames do not average it; the part that the filter has kept is taken out (``Counted``), or it would count twice.
What is left below 3 is along the line of sight, where one wrong sensor is allowed for.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy import stats

from drawn_rigs import Approach
from leadline.estimation import Estimate
from leadline.localizer.sight import Counted
from leadline.samples import Array, Kind, Measurement

FALSE_ALARM = 0.01
LEAST = {10: 1.3, 200: 2.1}  # of 3, by how many approaches: counted twice it was 1.6 to 2.0
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
    assert table.mean() > LEAST[approaches], told


def test_the_error_of_a_rig_is_in_the_stated_covariance_after_many_frames() -> None:
    check(10, 8)


def test_a_localizer_that_takes_its_rig_for_exact_is_found_out() -> None:
    values = nees(4, 8, exact=True)
    assert too_sure(values[:, -1])


def estimate(cov: Array) -> Estimate:
    return Estimate(0, np.array([0.0, 0.0, 2.0]), cov, np.zeros(3), np.eye(3), 0.0, 0.0)


def test_a_calibration_is_counted_once() -> None:
    """Noise R, calibration C: the filter says (R + C) / n after n frames, and it is R / n + C."""
    C, R = np.diag([1.0, 1.0, 4.0]), np.diag([2.0, 2.0, 5.0])
    frame = Measurement(Kind.STEREO, 0, np.zeros(3), R + C, lambda x: None)
    counted, before = Counted(), None
    for n in range(1, 6):
        after = estimate((R + C) / n)
        counted.take([frame], C, before, after)
        stated = counted.without(after) + C
        assert (np.diag(stated) >= np.diag(R / n + C) - 1e-12).all()
        assert (np.diag(stated) <= np.diag(R / n + 1.25 * C) + 1e-12).all()
        before = after
    first = Counted()
    first.take([frame], C, None, estimate(R + C))
    assert first.without(estimate(R + C)) == pytest.approx(R)


def test_what_is_predicted_or_murky_keeps_its_own_noise() -> None:
    """A share is taken out, of the variance that there was; where frames are believed less than they state, little."""
    C, R = np.eye(3), np.eye(3)
    frame = Measurement(Kind.STEREO, 0, np.zeros(3), R + C, lambda x: None)
    counted = Counted()
    counted.take([frame], C, None, estimate(R + C))
    assert counted.without(estimate(100 * np.eye(3))) == pytest.approx(99 * np.eye(3))
    assert counted.without(estimate(0.1 * np.eye(3))) == pytest.approx(0.05 * np.eye(3))
    murky = 18 * (R + C)  # noise that the filter takes to be so much larger
    counted.take([frame], C, estimate(murky), estimate(murky / 2))
    assert counted.without(estimate(murky / 2)) == pytest.approx(murky / 2 - 0.25 * C)


@pytest.mark.long
def test_the_error_of_a_rig_is_in_the_stated_covariance_of_two_hundred_approaches() -> None:
    check(200, 40)
