"""The filter beside an oracle that is spared the outliers, and beside GTSAM, on dives drawn from their noise.

The long form is the promise (1,000 dives); the short one the same at 60, with the bands of 60.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benchmarks.filter_dives import BEAM, LASER_SIGMA_M, Plan, draw, see_position, see_range
from benchmarks.filter_runs import SETTLED_S, Outcome, experiment

from leadline.estimation import Filter
from leadline.samples import NS_PER_S, Kind, Measurement

STANDARD = Plan("standard")
MOST_RATIO, MOST_TAIL = 1.1, 1.3


@cache
def standard(runs: int) -> Outcome:
    return experiment(STANDARD, runs)


def holds(outcome: Outcome) -> bool:
    """Mean NEES and NIS of 3 dimensions within what 95 % of the means over so many dives are at one time."""
    return max(abs(outcome.nees - 3), abs(outcome.nis - 3)) < outcome.band()


@pytest.mark.parametrize("runs", [60, pytest.param(1000, marks=pytest.mark.long)])
def test_as_good_as_an_oracle_without_the_outliers(runs: int) -> None:
    outcome = standard(runs)
    assert outcome.ratio <= MOST_RATIO
    assert outcome.tail <= MOST_TAIL
    assert outcome.lost == 0
    assert holds(outcome)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_would_notice_a_covariance_that_is_half_or_double(factor: float) -> None:
    outcome = standard(60)  # both are quadratic forms of the inverse of the covariance
    assert not holds(replace(outcome, nees=outcome.nees / factor, nis=outcome.nis / factor))


HARDER = {
    # The most that the RMS error may be against the oracle's, who knows the clock and what motion to expect.
    "dropouts": (Plan("dropouts", dropouts=2), 1.1),
    "bursts": (Plan("bursts", bursts=2), 1.2),
    "clock step": (Plan("clock step", clock_step_s=0.1), 1.2),
    "murky": (Plan("murky", noise_factor=2.0), 1.2),
    "lively": (Plan("lively", psd=0.1), 1.2),
    "calm": (Plan("calm", psd=0.001), 1.2),
}


@pytest.mark.parametrize("name", HARDER)
@pytest.mark.parametrize("runs", [12, pytest.param(300, marks=pytest.mark.long)])
def test_keeps_its_lock_where_it_is_harder(name: str, runs: int) -> None:
    plan, most = HARDER[name]
    outcome = experiment(plan, runs)
    assert outcome.lost == 0
    assert outcome.ratio <= most


@pytest.mark.parametrize("good", [1, 2])
def test_two_readings_that_contradict_wrong_ones_take_them_back(good: int) -> None:
    """While only the laser measures, three wrong ones in a row look like a target that moves: dive 98 of 300."""
    filt = Filter()
    for k in range(60):
        place = np.array([0.0, 0.0, 2.1 - 0.01 * k])
        if k == 0:
            filt.start(-1, place, 0.01 * np.eye(3))
        t_ns = k * NS_PER_S // 20
        filt.add(t_ns, [Measurement(Kind.STEREO, t_ns, place, 1e-5 * np.eye(3), see_position)])
    for k, wrong_m in enumerate([0.0, 0.0, 0.05, 0.13, 0.21] + good * [0.0], 1):
        t_ns = 3 * NS_PER_S + k * NS_PER_S // 3
        place = np.array([0.0, 0.0, 2.1 - 0.2 * t_ns / NS_PER_S])
        reading = BEAM @ place + wrong_m
        filt.add(t_ns, [Measurement(Kind.LASER, t_ns, reading, LASER_SIGMA_M**2 * np.eye(1), see_range)])
    off_m = float(np.linalg.norm(filt.at(t_ns).x - place))
    assert off_m < 0.02 if good == 2 else off_m > 0.2  # one alone may be wrong itself


def test_violent_motion_costs_nothing_against_single_frames() -> None:
    """1 m/s^2 at 0.22 m, where a frame is good to a quarter of a millimetre."""
    outcome = experiment(Plan("violent", motion="violent", standoff_m=0.22, camera_outliers=0.0), 6)
    assert np.median(outcome.at_stamp_m) <= 1.1 * np.median(outcome.single_m)


def test_is_not_worse_than_gtsam() -> None:
    """Its incremental fixed-lag smoother with a robust kernel, which is told the motion's power density."""
    pytest.importorskip("gtsam", reason="GTSAM is not installed (pip install gtsam)")
    from benchmarks.filter_gtsam import fixed_lag  # noqa: PLC0415

    runs = 15
    dives = draw(STANDARD, runs)
    late = dives.arrival_s > SETTLED_S
    theirs = [
        np.sqrt(((fixed_lag(dives, run, STANDARD.psd) - dives.now_m[run])[late] ** 2).sum(-1).mean())
        for run in range(runs)
    ]
    assert np.median(experiment(STANDARD, runs).rms_m) <= np.median(theirs)


def test_a_step_does_not_take_longer_with_time() -> None:
    outcome = experiment(Plan("long", seconds=60.0, standoff_m=1.0), 1)
    quarter = len(outcome.step_us) // 4
    assert np.median(outcome.step_us[-quarter:]) < 1.5 * np.median(outcome.step_us[:quarter])
