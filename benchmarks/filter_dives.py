"""Measurements of many dives at once for the filter's experiment, drawn straight from their noise: no images.

A camera at 20 Hz whose results come 80 ms late, a rangefinder at 3 Hz that comes 30 ms late; outliers, and what makes
it harder: dropouts, bursts, a clock that is set.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from leadline.samples import NS_PER_S, Array, Kind, Measurement

Motion = Literal["model", "smooth", "violent", "still"]
BEAM = np.array([[0.05, 0.02, np.sqrt(1 - 0.05**2 - 0.02**2)]])
LASER_SIGMA_M, DEPTH_SIGMA, ACROSS_SIGMA = 0.003, 0.004, 0.0005  # the camera's: per m^2 and per m
START_SIGMA_M, SPEED_SIGMA_M_S = 0.1, 0.4


@dataclass(frozen=True, slots=True)
class Plan:
    """What dives are like. Rates in Hz, delays in s, outliers as fractions."""

    name: str
    motion: Motion = "model"
    seconds: float = 12.0
    camera_outliers: float = 0.05
    laser_outliers: float = 0.03
    dropouts: int = 0  # of the camera, each 1 to 3 s
    bursts: int = 0  # of 3 to 6 frames that show something else, all the same
    clock_step_s: float = 0.0  # of the laser's clock, somewhere in the middle
    clock_sigma_s: float = 0.0  # of the laser's clock from the start
    noise_factor: float = 1.0  # of both sensors' real noise, against what is stated
    psd: float = 0.01  # m^2/s^3, of the motion drawn from the model
    standoff_m: float | None = None  # what the camera is worth is that of this distance throughout


@dataclass(frozen=True, slots=True)
class Dives:
    """N dives with the same K stamps. Times in s (K,), in the order of arrival."""

    plan: Plan
    t_s: Array
    arrival_s: Array
    is_laser: NDArray[np.bool_]
    truth_m: Array  # (N, K, 3) at the stamp
    now_m: Array  # (N, K, 3) at the arrival, when the answer is wanted
    z_m: Array  # (N, K, 3); a reading in the first column
    cov_m2: Array  # (N, K, 3, 3) as stated; a reading's in the first cell
    there: NDArray[np.bool_]  # (N, K) that it came at all
    good: NDArray[np.bool_]  # (N, K) and is no outlier
    start_m: Array  # (N, 3) the first idea

    def measurement(self, run: int, k: int) -> Measurement:
        t_ns = round(float(self.t_s[k]) * NS_PER_S)
        if self.is_laser[k]:
            return Measurement(Kind.LASER, t_ns, self.z_m[run, k, :1], self.cov_m2[run, k, :1, :1], see_range)
        return Measurement(Kind.STEREO, t_ns, self.z_m[run, k], self.cov_m2[run, k], see_position)


_EYE = np.eye(3)


def see_position(x: Array) -> tuple[Array, Array]:
    return x, _EYE


def see_range(x: Array) -> tuple[Array, Array]:
    return BEAM @ x, BEAM


def draw(plan: Plan, runs: int, seed: int = 1) -> Dives:
    rng = np.random.default_rng(seed)
    t_s, arrival_s, is_laser = _schedule(plan, rng)
    path = _paths(plan, runs, rng)
    truth, now = path(t_s), path(arrival_s)
    z, cov = np.zeros_like(truth), np.zeros((*truth.shape, 3))
    clock_s = rng.normal(0, plan.clock_sigma_s, runs)[:, None] + np.zeros(len(t_s))
    clock_s = clock_s + plan.clock_step_s * (t_s > rng.uniform(0.4, 0.6, runs)[:, None] * plan.seconds)
    _cameras(plan, t_s, truth, z, cov, rng)
    _lasers(plan, path, t_s + clock_s, is_laser, z, cov, rng)
    there, good = _faults(plan, t_s, is_laser, truth, z, rng)
    start = truth[:, 0] + rng.normal(0, START_SIGMA_M, (runs, 3))
    return Dives(plan, t_s, arrival_s, is_laser, truth, now, z, cov, there, good, start)


def _schedule(plan: Plan, rng: np.random.Generator) -> tuple[Array, Array, NDArray[np.bool_]]:
    camera = np.arange(0.05, plan.seconds, 0.05) + rng.uniform(-0.002, 0.002, len(np.arange(0.05, plan.seconds, 0.05)))
    laser = np.arange(0.11, plan.seconds, 1 / 3)
    t_s = np.concatenate([camera, laser])
    late = np.concatenate([0.08 + rng.exponential(0.004, len(camera)), np.full(len(laser), 0.03)])
    order = np.argsort(t_s + late)
    return t_s[order], (t_s + late)[order], (np.arange(len(t_s)) >= len(camera))[order]


Path = Callable[[Array], Array]


def _paths(plan: Plan, runs: int, rng: np.random.Generator) -> Path:
    """Position (N, K, 3) at times (K,) or (N, K)."""
    if plan.motion == "model":
        return _drawn(plan, runs, rng)
    speed = {"smooth": 0.2, "violent": 0.1, "still": 0.0}[plan.motion]
    sway = {"smooth": (0.02, 0.015, 0.004), "violent": (0.1, 0.1, 0.1), "still": (0.0, 0.0, 0.0)}[plan.motion]
    slowest_s = 2.0 if plan.motion == "violent" else 6.0  # violent: 0.1 m at 2 s and its overtones: about 1 m/s^2
    rate = 2 * np.pi / slowest_s * np.array([1.0, 1.9, 3.1]) * rng.uniform(0.8, 1.2, (runs, 1, 3, 3))
    phase = rng.uniform(0, 2 * np.pi, (runs, 1, 3, 3))
    size = np.array(sway)[:, None] * np.array([0.6, 0.3, 0.1])
    begin = np.concatenate([rng.normal(0, 0.05, (runs, 2)), rng.uniform(2.0, 2.2, (runs, 1))], axis=1)

    def path(t_s: Array) -> Array:
        t = np.broadcast_to(t_s, (runs, t_s.shape[-1]))
        result = begin[:, None] + (size * np.sin(rate * t[..., None, None] + phase)).sum(-1)
        travel = 1.8 / speed if speed else np.inf
        u = np.clip((t - 1.0) / travel, 0, 1)
        result[..., 2] -= 1.8 * (u - 0.8 / (2 * np.pi) * np.sin(2 * np.pi * u))  # a soft start, a soft stop
        return np.asarray(result)

    return path


def _drawn(plan: Plan, runs: int, rng: np.random.Generator) -> Path:
    """White acceleration on a fine grid; between its points the cubic through positions and velocities."""
    h = 0.005
    count = int((plan.seconds + 1) / h) + 2
    kick = (
        rng.normal(size=(runs, count, 3, 2))
        @ np.linalg.cholesky(plan.psd * np.array([[h**3 / 3, h**2 / 2], [h**2 / 2, h]])).T
    )
    v = np.concatenate([np.zeros((runs, 1, 3)), np.cumsum(kick[..., 1], axis=1)[:, :-1]], axis=1)
    v += np.array([0, 0, -0.18]) + rng.normal(0, 0.03, (runs, 1, 3))
    p = np.concatenate([np.zeros((runs, 1, 3)), np.cumsum(v * h + kick[..., 0], axis=1)[:, :-1]], axis=1)
    p += np.array([0, 0, 2.1])

    def path(t_s: Array) -> Array:
        t = np.broadcast_to(t_s, (runs, t_s.shape[-1]))
        i = np.clip((t / h).astype(int), 0, count - 2)
        u = (t / h - i)[..., None]
        row = np.arange(runs)[:, None]
        p0, p1, v0, v1 = p[row, i], p[row, i + 1], h * v[row, i], h * v[row, i + 1]
        return np.asarray(
            (1 + 2 * u) * (1 - u) ** 2 * p0 + u * (1 - u) ** 2 * v0 + u**2 * (3 - 2 * u) * p1 + u**2 * (u - 1) * v1
        )

    return path


def _cameras(plan: Plan, t_s: Array, truth: Array, z: Array, cov: Array, rng: np.random.Generator) -> None:
    # What the camera is worth is that of an even approach straight ahead, so that all dives are equally hard.
    even = np.maximum(2.1 - 0.18 * t_s, 0.3) if plan.standoff_m is None else np.full(len(t_s), plan.standoff_m)
    distance = np.broadcast_to(even, truth.shape[:2])
    sight = np.array([0.0, 0.0, 1.0])
    depth, across = DEPTH_SIGMA * distance**2, ACROSS_SIGMA * distance
    along = np.outer(sight, sight)
    cov[:] = (across**2)[..., None, None] * np.eye(3) + (depth**2 - across**2)[..., None, None] * along
    noise = across[..., None] * rng.normal(size=truth.shape)
    noise[..., 2] = depth * rng.normal(size=depth.shape)
    z[:] = truth + plan.noise_factor * noise


def _lasers(
    plan: Plan,
    path: Path,
    taken_s: Array,
    is_laser: NDArray[np.bool_],
    z: Array,
    cov: Array,
    rng: np.random.Generator,
) -> None:
    reading = path(taken_s)[:, is_laser] @ BEAM[0]
    z[:, is_laser] = 0
    z[:, is_laser, 0] = reading + plan.noise_factor * rng.normal(0, LASER_SIGMA_M, reading.shape)
    cov[:, is_laser] = LASER_SIGMA_M**2 * np.eye(3)


def _faults(
    plan: Plan, t_s: Array, is_laser: NDArray[np.bool_], truth: Array, z: Array, rng: np.random.Generator
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Outliers put into z; which samples came, and which of them are good."""
    shape = truth.shape[:2]
    wrong = rng.random(shape) < np.where(is_laser, plan.laser_outliers, plan.camera_outliers)
    size = rng.choice([-1.0, 1.0], shape) * np.exp(rng.uniform(np.log(0.03), np.log(1.0), shape))
    sight = np.array([0.0, 0.0, 1.0])
    off = size[..., None] * sight + rng.normal(0, 0.05, truth.shape)
    there = np.ones(shape, bool)
    for run in range(shape[0]):
        for _ in range(plan.dropouts):
            begin = rng.uniform(2, plan.seconds - 3)
            there[run] &= is_laser | (t_s < begin) | (t_s > begin + rng.uniform(1, 3))
        for _ in range(plan.bursts):
            begin, other = rng.uniform(2, plan.seconds), rng.uniform(-0.5, 0.5) * sight + rng.normal(0, 0.1, 3)
            burst = ~is_laser & (t_s > begin) & (t_s < begin + rng.uniform(0.15, 0.3))
            wrong[run] |= burst
            off[run, burst] = other
    z += np.where(wrong[..., None], np.where(is_laser[:, None], size[..., None] * [1, 0, 0], off), 0)
    return there, there & ~wrong
