"""The smoother: equal to least squares over the whole dive, honest, and never worse than the filter."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from benchmarks.filter_dives import START_SIGMA_M, Plan, draw

from leadline.errors import InputError
from leadline.estimation import Filter, FilterSettings
from leadline.localizer import SmoothingLocalizer
from leadline.pipeline import build_job
from leadline.samples import NS_PER_S, Array, Kind, Measurement
from leadline.target import Sphere
from short_dives import TrueBoxes, cut, range_errors, samples

GAUSSIAN = FilterSettings(student_nu=1e9, gate_sigmas=50.0, adapt=False, laser_clock_sigma_s=0.0)
EYE = np.eye(3)


def ns(t_s: float) -> int:
    return round(float(t_s) * NS_PER_S)


def test_equals_least_squares_over_the_whole_dive() -> None:
    rng, dt, count, psd = np.random.default_rng(1), 0.1, 12, GAUSSIAN.acceleration_psd
    z = np.array([0, 0, 2.0]) + rng.normal(0, 0.02, (count, 3))
    filt = Filter(GAUSSIAN, keep=True)
    filt.start(0, np.array([0.0, 0.0, 2.0]), 0.1**2 * EYE)
    for i in rng.permutation(count):
        t_ns = ns(dt * (i + 1))
        filt.add(t_ns, [Measurement(Kind.STEREO, t_ns, z[i], 0.01**2 * EYE, lambda x: (x, EYE))])
    y, cov = least_squares(z, dt, psd)
    smoothed = filt.smoothed()
    for i in range(count):
        estimate = smoothed.at(ns(dt * (i + 1)))
        assert estimate is not None
        assert estimate.x == pytest.approx(y[i + 1, :3], abs=1e-7)
        assert estimate.velocity_m_s == pytest.approx(y[i + 1, 3:], abs=1e-6)
        assert estimate.cov == pytest.approx(cov[i + 1, :3, :3], rel=1e-4, abs=1e-12)
    assert smoothed.at(-1) is None


def least_squares(z: Array, dt: float, psd: float) -> tuple[Array, Array]:
    """All states (n + 1, 6) at once with their covariances, from prior, motion and positions."""
    n = len(z)
    information, pull = np.zeros((6 * n + 6, 6 * n + 6)), np.zeros(6 * n + 6)
    start = np.diag([1 / 0.1**2] * 3 + [1 / GAUSSIAN.initial_speed_m_s**2] * 3)
    information[:6, :6] += start
    pull[:6] += start @ [0, 0, 2.0, 0, 0, 0]
    F = np.kron([[1, dt], [0, 1]], EYE)
    W = np.linalg.inv(psd * np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], EYE))
    for i in range(n):
        step = np.zeros((6, 6 * n + 6))
        step[:, 6 * i : 6 * i + 6], step[:, 6 * i + 6 : 6 * i + 12] = -F, np.eye(6)
        information += step.T @ W @ step
        at = slice(6 * i + 6, 6 * i + 9)
        information[at, at] += EYE / 0.01**2
        pull[at] += z[i] / 0.01**2
    cov = np.linalg.inv(information)
    blocks = np.array([cov[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] for i in range(n + 1)])
    return (cov @ pull).reshape(n + 1, 6), blocks


@pytest.mark.parametrize("plan", [Plan("standard"), Plan("clock step", clock_step_s=0.1)], ids=lambda plan: plan.name)
def test_is_honest_and_better_than_the_filter(plan: Plan) -> None:
    """20 dives with outliers, 200 places each: mean NEES of 3; half or double the covariance is far out."""
    dives = draw(plan, 20)
    filtered, smoothed, nees = [], [], []
    for run in range(20):
        filt = Filter(keep=True)
        filt.start(ns(dives.t_s[0]) - 1, dives.start_m[run], START_SIGMA_M**2 * EYE)
        then = []
        for k in range(len(dives.t_s)):
            m = dives.measurement(run, k)
            filt.add(m.t_ns, [m])
            then.append(filt.at(m.t_ns).x)
        states = filt.smoothed()
        for k in range(40, len(dives.t_s)):
            state = states.at(ns(dives.t_s[k]))
            assert state is not None
            error = state.x - dives.truth_m[run, k]
            filtered.append(then[k] - dives.truth_m[run, k])
            smoothed.append(error)
            nees.append(error @ np.linalg.solve(state.cov, error))
    assert np.mean(np.square(smoothed)) < 0.5 * np.mean(np.square(filtered))
    assert 2.5 < np.mean(nees) < 3.5


def test_a_track_that_was_wrong_does_not_pull_at_the_next() -> None:
    filt = Filter(keep=True)
    filt.start(0, np.array([0.0, 0.0, 2.0]), 0.01 * EYE)
    for i in range(1, 60):
        t_ns, z = ns(0.05 * i), np.array([0, 0, 2.0 if i < 30 else 1.2])
        filt.add(t_ns, [Measurement(Kind.STEREO, t_ns, z, 0.005**2 * EYE, lambda x: (x, EYE))])
    smoothed = filt.smoothed()
    for i in range(1, 60):
        state = smoothed.at(ns(0.05 * i))
        assert state is not None
        assert state.x[2] == pytest.approx(2.0 if i < 30 else 1.2, abs=0.01)


def test_a_simulated_dive_is_smoother_than_it_was() -> None:
    dive = cut("demo")
    localizer = SmoothingLocalizer(dive.rig, Sphere(0.34), TrueBoxes(dive))
    told = [solution for sample in samples(dive) if (solution := localizer.step(sample)) is not None]
    smoothed = localizer.smoothed()
    assert [(s.t_ns, s.stage, s.status, s.used) for s in smoothed] == [
        (s.t_ns, s.stage, s.status, s.used) for s in told
    ]
    before, _ = range_errors(told, dive)
    after, sigma = range_errors(smoothed, dive)
    assert np.sqrt(np.mean(after**2)) <= np.sqrt(np.mean(before**2))
    assert np.mean(np.abs(after) < 3 * sigma) > 0.95


def test_smooth_is_of_our_filter(tmp_path: Path) -> None:
    for options in ({"filtered": False}, {"methods": ("paper",)}):
        with pytest.raises(InputError, match="--smooth"):
            build_job("sim:demo", smoothed=True, **options)  # type: ignore[arg-type]


def test_run_writes_smoothed_beside_solutions(tmp_path: Path) -> None:
    from leadline.sinks import SolutionsCsv  # noqa: PLC0415
    from leadline.wire.solutions import HEADER, read_solutions  # noqa: PLC0415

    dive = cut("demo")
    localizer = SmoothingLocalizer(dive.rig, Sphere(0.34), TrueBoxes(dive))
    for sample in samples(dive)[:6]:
        localizer.step(sample)
    table = SolutionsCsv(tmp_path / "smoothed.csv")
    for solution in localizer.smoothed():
        table.solution(solution)
    table.close()
    with (tmp_path / "smoothed.csv").open(newline="") as file:
        assert tuple(next(csv.reader(file))) == HEADER
    assert len(read_solutions(tmp_path / "smoothed.csv")) == len(localizer.smoothed())
