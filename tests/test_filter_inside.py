"""What the filter is made of: motion models, the laser's clock, the vehicle's motion, noise that adapts, recovery."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from leadline.estimation import Filter, FilterSettings
from leadline.estimation.models import MotionModel, rotation, singer, white_acceleration
from leadline.estimation.small import inverse
from leadline.estimation.student import Settled, _at_large, _by_hand
from leadline.samples import NS_PER_S, Array, Kind, Measurement, VehicleMotion

EYE = np.eye(3)
ROW = np.array([[0.0, 0.0, 1.0]])
PLAIN = FilterSettings(adapt=False, laser_clock_sigma_s=0.0)


def ns(t_s: float) -> int:
    return round(t_s * NS_PER_S)


def position(t_s: float, z: Array, sigma_m: float = 0.005) -> Measurement:
    return Measurement(Kind.STEREO, ns(t_s), np.asarray(z, float), sigma_m**2 * EYE, lambda x: (x[:3], EYE))


def reading(t_s: float, z: float, sigma_m: float = 0.003) -> Measurement:
    cov = np.array([[sigma_m**2]])
    return Measurement(Kind.LASER, ns(t_s), np.array([z]), cov, lambda x: (ROW @ x[:3], ROW))


def started(settings: FilterSettings | None = None, z: float = 2.0) -> Filter:
    filt = Filter(settings)
    filt.start(0, np.array([0.0, 0.0, z]), 0.1**2 * EYE)
    return filt


@pytest.mark.parametrize("dt", [0.001, 0.015, 0.1, 1.0, 3.0])
@pytest.mark.parametrize("model", ["velocity", "acceleration"])
def test_noise_of_a_step_is_the_integral_of_its_equation(model: str, dt: float) -> None:
    manoeuvre_s, count = 0.7, 4000
    A = np.diag([1.0, 1.0], 1) if model == "acceleration" else np.diag([1.0], 1)
    if model == "acceleration":
        A[2, 2] = -1 / manoeuvre_s
    size, h = len(A), dt / count
    half = np.eye(size) + A * h / 2 + A @ A * h**2 / 8
    Phi, kick, Q = np.eye(size), np.zeros(size), np.zeros((size, size))
    kick[-1] = 1 / manoeuvre_s if model == "acceleration" else 1.0
    for _ in range(count):  # the midpoint rule, from the end back
        g = Phi @ half @ kick
        Q += np.outer(g, g) * h
        Phi = Phi @ half @ half
    F, noise = singer(dt, manoeuvre_s) if model == "acceleration" else ({(0, 1): dt}, white_acceleration(dt))
    for (i, j), value in noise.items():
        assert value == pytest.approx(Q[i, j], rel=0.02 if dt < 0.02 * manoeuvre_s else 2e-3)
    for (i, j), value in F.items():
        assert value == pytest.approx(Phi[i, j], rel=1e-4)


@pytest.mark.parametrize("model", ["velocity", "acceleration"])
def test_two_steps_are_one(model: str) -> None:
    settings = replace(FilterSettings(), model=model)
    motion = MotionModel(settings, np.array([0.1]))
    state = motion.start(0, np.array([0.1, 0.2, 1.0, 0.3]), 0.01 * np.eye(4))
    once, twice = motion.predict(state, ns(1.0)), motion.predict(motion.predict(state, ns(0.4)), ns(1.0))
    assert once.y == pytest.approx(twice.y, abs=1e-12)
    assert np.allclose(once.P, twice.P, rtol=1e-6, atol=1e-12)


def test_the_acceleration_model_follows_what_the_other_lags_behind() -> None:
    errors = {}
    for model, psd in (("velocity", 0.1), ("acceleration", 10.0)):
        filt = started(replace(PLAIN, model=model, manoeuvre_s=20.0, acceleration_psd=psd))
        for i in range(1, 60):
            t = 0.05 * i
            filt.add(ns(t), [position(t, [0, 0, 2.0 - 0.4 * t**2])])
        errors[model] = abs(filt.at(ns(59 * 0.05)).x[2] - (2.0 - 0.4 * (59 * 0.05) ** 2))
    assert errors["acceleration"] < 0.5 * errors["velocity"]


def test_by_hand_is_what_numpy_says() -> None:
    rng = np.random.default_rng(0)
    for m in (1, 2, 3):
        for _ in range(50):
            A, R = rng.normal(size=(2, m, m))
            A, R, off = A @ A.T, R @ R.T + 0.1 * np.eye(m), 2 * rng.normal(size=m)
            hand, numpy = _by_hand(A, R, off, 4.0, 1e9), _at_large(A, R, off, 4.0, 1e9)
            assert isinstance(hand, Settled)
            assert isinstance(numpy, Settled)
            assert hand.nis == pytest.approx(numpy.nis, rel=1e-9)
            assert hand.inverse == pytest.approx(numpy.inverse, rel=1e-6, abs=1e-9)
            assert hand.w == pytest.approx(numpy.w, rel=1e-6, abs=1e-9)
    assert inverse((1.0, 2.0, 1.0, 0.0, 0.0, 1.0)) is None


def test_numbers_that_are_none_are_turned_away() -> None:
    filt = started()
    broken = replace(position(0.1, [0, 0, 2.0]), cov=-EYE)
    for wrong in (broken, position(0.1, [np.nan, 0, 2.0]), reading(0.1, np.nan)):
        used, rejected = filt.add(wrong.t_ns, [wrong])
        assert not used
        assert rejected[0].reason == "is not a number"


def approach(filt: Filter, tau_s: float, seconds: float, speed: float, rng: np.random.Generator) -> None:
    """A reading stamped t was taken at t + tau."""
    for i in range(1, int(seconds * 20)):
        t = 0.05 * i
        filt.add(ns(t), [position(t, np.array([0, 0, 2.0 - speed * t]) + rng.normal(0, 0.005, 3))])
        if i % 7 == 0:
            filt.add(ns(t + 0.02), [reading(t + 0.02, 2.0 - speed * (t + 0.02 + tau_s) + rng.normal(0, 0.003))])


@pytest.mark.parametrize("tau_s", [-0.06, 0.0, 0.04])
def test_the_lasers_clock_is_found_while_the_target_moves(tau_s: float) -> None:
    filt = started()
    approach(filt, tau_s, 8.0, 0.22, np.random.default_rng(4))
    estimate = filt.at(ns(8.0))
    assert estimate.laser_clock_sigma_s < 0.006
    assert abs(estimate.laser_clock_s - tau_s) < 3.3 * estimate.laser_clock_sigma_s
    assert abs(estimate.x[2] - (2.0 - 0.22 * 8.0)) < 3.3 * np.sqrt(estimate.cov[2, 2])


def test_the_lasers_clock_costs_nothing_where_nothing_moves() -> None:
    sigma = {}
    for clock_s in (0.0, 0.05):
        filt = started(replace(FilterSettings(), laser_clock_sigma_s=clock_s, acceleration_psd=1e-4))
        approach(filt, 0.0, 8.0, 0.0, np.random.default_rng(5))
        estimate = filt.at(ns(8.0))
        sigma[clock_s] = np.sqrt(estimate.cov[2, 2])
        if clock_s:
            assert estimate.laser_clock_sigma_s > 0.03
    assert sigma[0.05] < 1.05 * sigma[0.0]


def test_a_lasers_clock_that_is_set_is_found_again() -> None:
    filt, rng = started(), np.random.default_rng(6)
    for i in range(1, 240):
        t = 0.05 * i
        filt.add(ns(t), [position(t, np.array([0, 0, 2.0 - 0.2 * t]) + rng.normal(0, 0.002, 3), 0.002)])
        if i % 7 == 0:
            tau_s = 0.0 if t < 6 else 0.15
            z = 2.0 - 0.2 * (t + tau_s) + rng.normal(0, 0.003)
            used, _ = filt.add(ns(t), [reading(t, z)])
    assert used
    assert filt.at(ns(11.95)).laser_clock_s == pytest.approx(0.15, abs=0.02)


def test_the_vehicles_velocity_carries_it_through_a_gap() -> None:
    """A second without cameras, in which the vehicle stops."""
    error = {}
    for told in (False, True):
        filt = started()
        for i in range(1, 80):
            t = 0.05 * i
            speed, z = (0.2, 2.0 - 0.2 * t) if t < 3 else (0.0, 1.4)
            if t < 3:
                filt.add(ns(t), [position(t, [0, 0, z])])
            if told and i % 4 == 0:
                filt.add_motion(VehicleMotion(ns(t), (0.0, 0.0, speed), None, 0.01))
        error[told] = abs(filt.at(ns(3.95)).x[2] - 1.4)
    assert error[False] > 0.1
    assert error[True] < 0.03


def test_a_turn_that_is_measured_costs_nothing() -> None:
    """The camera swings by 0.1 rad at 0.7 Hz before a still target: the filter knows from the gyroscope."""
    error = {}
    for told in (False, True):
        filt, rng, off = started(PLAIN), np.random.default_rng(7), []
        for i in range(1, 100):
            t = 0.05 * i
            angle, rate = 0.1 * np.sin(4.4 * t), 0.44 * np.cos(4.4 * (t - 0.025))
            if told:
                filt.add_motion(VehicleMotion(ns(t) - 1, None, (0.0, rate, 0.0)))
            p = rotation(np.array([0, -angle, 0])) @ [0, 0, 2.0]
            filt.add(ns(t), [position(t, p + rng.normal(0, 0.005, 3))])
            off.append(np.linalg.norm(filt.at(ns(t)).x - p))
        error[told] = np.sqrt(np.mean(np.square(off[20:])))
    assert error[True] < 0.4 * error[False]


def noise_of(filt: Filter) -> object:
    return filt._history.entries[-1].after.noise


@pytest.mark.parametrize(("factor", "least", "most"), [(0.5, 1.0, 1.01), (1.0, 1.0, 1.3), (2.5, 3.0, 9.0)])
def test_measurement_noise_follows_the_water_but_never_below_what_is_stated(
    factor: float, least: float, most: float
) -> None:
    filt, rng = started(), np.random.default_rng(8)
    for i in range(1, 400):
        t = 0.05 * i
        filt.add(ns(t), [position(t, [0, 0, 2.0] + factor * rng.normal(0, 0.005, 3))])
    assert least <= noise_of(filt).scale(Kind.STEREO) <= most  # type: ignore[attr-defined]


@pytest.mark.parametrize("psd", [0.0005, 0.2])
def test_process_noise_follows_the_motion(psd: float) -> None:
    filt, rng, told = started(), np.random.default_rng(9), []
    dt, y = 0.05, np.zeros((2, 3))
    L = np.linalg.cholesky(psd * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]]))
    for i in range(1, 800):
        y = np.array([[1, dt], [0, 1]]) @ y + L @ rng.normal(size=(2, 3))
        filt.add(ns(dt * i), [position(dt * i, [0, 0, 2.0] + y[0] + rng.normal(0, 0.005, 3))])
        told.append(noise_of(filt).acceleration_psd)  # type: ignore[attr-defined]
    assert 0.5 < np.exp(np.mean(np.log(told[300:]))) / psd < 2.0


def test_a_wrong_position_that_was_taken_is_taken_back() -> None:
    filt = started()
    for i in range(1, 20):
        filt.add(ns(0.05 * i), [position(0.05 * i, [0, 0, 2.0])])
    gap = 3.0  # after which the filter cannot tell
    used, _ = filt.add(ns(gap), [position(gap, [0.1, 0, 2.3])])
    assert used
    for i in range(1, 3):
        used, _ = filt.add(ns(gap + 0.05 * i), [position(gap + 0.05 * i, [0, 0, 2.0])])
        assert used
    assert filt.at(ns(gap + 0.1)).x == pytest.approx([0, 0, 2.0], abs=0.01)


def test_a_few_frames_of_something_else_do_not_carry_it_off() -> None:
    filt = started()
    for i in range(1, 40):
        t, z = 0.05 * i, 1.5 if 20 <= i < 25 else 2.0
        filt.add(ns(t), [position(t, [0, 0, z])])
        if i > 5:
            assert filt.at(ns(t)).x[2] == pytest.approx(2.0, abs=0.02)


def test_a_clock_that_is_set_back_is_survived() -> None:
    filt = started()
    for i in range(1, 100):
        filt.add(ns(0.05 * i), [position(0.05 * i, [0, 0, 2.0])])
    for i in range(1, 30):  # four seconds before: older than the horizon
        filt.add(ns(1.0 + 0.05 * i), [position(1.0 + 0.05 * i, [0, 0, 1.8])])
    assert filt.at(ns(2.45)).x[2] == pytest.approx(1.8, abs=0.01)
