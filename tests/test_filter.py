"""The filter: equal to a plain Kalman filter on clean data, order-free, robust, and able to find back."""

from __future__ import annotations

import numpy as np
import pytest

from leadline.estimation import Filter, FilterSettings
from leadline.samples import NS_PER_S, Array, Kind, Measurement, Rejected

GAUSSIAN = FilterSettings(student_nu=1e9, gate_sigmas=50.0, adapt=False, laser_clock_sigma_s=0.0)


def position(t_s: float, z: Array, sigma_m: float, kind: Kind = Kind.STEREO) -> Measurement:
    return Measurement(kind, round(t_s * NS_PER_S), z, sigma_m**2 * np.eye(3), lambda x: (x[:3], np.eye(3, len(x))))


def along_z(t_s: float, z: float, sigma_m: float) -> Measurement:
    row = np.array([[0.0, 0.0, 1.0]])
    return Measurement(
        Kind.LASER, round(t_s * NS_PER_S), np.array([z]), np.array([[sigma_m**2]]), lambda x: (row @ x[:3], row)
    )


def start(settings: FilterSettings = GAUSSIAN) -> Filter:
    filt = Filter(settings)
    filt.start(0, np.array([0.0, 0.0, 2.0]), 0.1**2 * np.eye(3))
    return filt


def plain_kalman(measurements: list[Measurement], psd: float) -> tuple[Array, Array]:
    """The textbook filter on (position, velocity), written independently."""
    y, P, t = np.array([0, 0, 2.0, 0, 0, 0]), np.diag([0.01] * 3 + [0.16] * 3), 0.0
    for m in measurements:
        dt, t = m.t_ns / NS_PER_S - t, m.t_ns / NS_PER_S
        F = np.block([[np.eye(3), dt * np.eye(3)], [np.zeros((3, 3)), np.eye(3)]])
        Q = psd * np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], np.eye(3))
        y, P = F @ y, F @ P @ F.T + Q
        H = np.hstack([m.predict(y[:3])[1], np.zeros((len(m.z), 3))])  # type: ignore[index]
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + m.cov)
        y, P = y + K @ (m.z - H @ y), (np.eye(6) - K @ H) @ P
    return y, P


def dive(rng: np.random.Generator) -> list[Measurement]:
    result: list[Measurement] = []
    for i in range(1, 60):
        t = i * 0.05
        true = np.array([0.0, 0.0, 2.0 - 0.2 * t])
        result.append(position(t, true + rng.normal(0, 0.01, 3), 0.01))
        if i % 7 == 0:
            result.append(along_z(t + 0.02, float(true[2] - 0.004 + rng.normal(0, 0.003)), 0.003))
    return result


def test_equals_a_plain_kalman_filter_on_clean_data() -> None:
    measurements = dive(np.random.default_rng(1))
    filt = start()
    for m in measurements:
        filt.add(m.t_ns, [m])
    estimate = filt.at(measurements[-1].t_ns)
    y, P = plain_kalman(measurements, GAUSSIAN.acceleration_psd)
    assert estimate.x == pytest.approx(y[:3], abs=1e-6)
    assert estimate.cov == pytest.approx(P[:3, :3], rel=1e-4, abs=1e-12)


def test_late_measurements_give_the_same_as_timely_ones() -> None:
    measurements = dive(np.random.default_rng(2))
    timely, late = start(FilterSettings()), start(FilterSettings())
    for m in measurements:
        timely.add(m.t_ns, [m])
    arrival = sorted(measurements, key=lambda m: m.t_ns + (80_000_000 if m.kind is Kind.STEREO else 0))
    assert [m.t_ns for m in arrival] != [m.t_ns for m in measurements]
    for m in arrival:
        late.add(m.t_ns, [m])
    end = measurements[-1].t_ns
    assert late.at(end).x == pytest.approx(timely.at(end).x, abs=1e-12)


def test_older_than_the_horizon_is_told() -> None:
    filt = start()
    for i in range(1, 80):
        filt.add(i * 50_000_000, [along_z(i * 0.05, 2.0, 0.01)])
    used, rejected = filt.add(500_000_000, [along_z(0.5, 2.0, 0.01)])
    assert not used
    assert rejected == [Rejected(Kind.LASER, 500_000_000, "too late")]


def test_outliers_barely_move_it_and_are_told() -> None:
    filt = start(FilterSettings())
    for i in range(1, 40):
        t = i * 0.05
        wrong = 0.3 if i % 10 == 9 else 0.0
        _, rejected = filt.add(round(t * NS_PER_S), [position(t, np.array([0, 0, 2.0 + wrong]), 0.01)])
        assert bool(rejected) == (wrong > 0)
    assert filt.at(2 * NS_PER_S).x == pytest.approx([0, 0, 2.0], abs=0.005)


def test_finds_back_after_a_real_jump() -> None:
    filt = start(FilterSettings())
    for i in range(1, 60):
        t = i * 0.05
        z = 2.0 if i < 30 else 1.2
        filt.add(round(t * NS_PER_S), [position(t, np.array([0, 0, z]), 0.005)])
    assert filt.at(3 * NS_PER_S).x[2] == pytest.approx(1.2, abs=0.01)


def test_impossible_measurement_is_a_value_not_a_crash() -> None:
    filt = start()
    impossible = Measurement(Kind.LASER, 100, np.zeros(1), np.eye(1), lambda x: None)
    used, rejected = filt.add(100, [impossible])
    assert not used
    assert rejected[0].reason == "is beside the target, or grazes it"


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_nees_is_honest_and_would_notice_a_wrong_covariance(factor: float) -> None:
    """200 dives drawn from the model: mean NEES of 3 in its 99.9 % band; half or double the covariance is out."""
    rng, total, runs = np.random.default_rng(3), 0.0, 200
    psd, dt = GAUSSIAN.acceleration_psd, 0.1
    noise = np.linalg.cholesky(psd * np.kron([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]], np.eye(3)))
    for _ in range(runs):
        y = np.concatenate([rng.normal([0, 0, 2.0], 0.1), rng.normal(0, 0.4, 3)])
        filt = start()
        for i in range(1, 25):
            y = np.concatenate([y[:3] + dt * y[3:], y[3:]]) + noise @ rng.normal(size=6)
            filt.add(round(i * dt * NS_PER_S), [position(i * dt, y[:3] + rng.normal(0, 0.01, 3), 0.01)])
        estimate = filt.at(round(24 * dt * NS_PER_S))
        error = estimate.x - y[:3]
        total += float(error @ np.linalg.solve(factor * estimate.cov, error))
    inside = abs(total / runs - 3) < 3.29 * np.sqrt(6 / runs)
    assert inside == (factor == 1.0)
