"""What a row of differences between laser and cameras is made of: an offset, a scale, a clock.

A wrong index of the water makes both lengths wrong in proportion, and with opposite signs: a pool's rig in the sea is
off by 1.1 %. A reading that is stamped late by tau is off by tau times the speed. At an even speed that looks like an
offset, and a scale looks like a clock whose error grows. So a clock is told only where offset and scale are free as
well, and an offset or a scale, of which there is one at a time, beside the clock's usual error.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from leadline.samples import Array

FREE_M, FREE, NONE = 10.0, 1.0, 1e-9  # sigmas of what may be anything (a broken laser), and of what is not there
WATERS = 0.02  # of the scale, by other waters
ROUNDS, SETTLED = 8, 0.05  # and sigmas of the last step
TAIL_SIGMAS = 3.0  # differences beyond count less and less
VARIED = 4.0  # times the variance of its noise: a speed that varies enough to tell a clock


class Difference(NamedTuple):
    """Reading minus what the cameras saw (m) of a beam of this length, which grew at this speed.

    noise_m2: of this difference alone; common_m2: of the calibrations; speed_noise: variance of the speed.
    """

    metres: float
    length_m: float
    speed_m_s: float
    noise_m2: float
    common_m2: float
    speed_noise: float


class Bias(NamedTuple):
    """By how much (m) the laser reads longer than the cameras see, at the newest length, with its variance."""

    metres: float
    variance_m2: float

    @property
    def sigmas(self) -> float:
        return abs(self.metres) / float(np.sqrt(self.variance_m2))


class Biases(NamedTuple):
    """What explains the differences, if it is alone: one offset, or one scale."""

    offset: Bias
    scale: Bias


def biases(differences: Sequence[Difference], clock_s: float, clock_sigma_s: float) -> Biases:
    """Beside a clock that is known within its sigma."""
    table = np.array(differences).T
    length, common, last_m = table[1], table[4], differences[-1].length_m
    offset, cov = _fit(table, clock_s, (FREE_M, NONE, clock_sigma_s))
    scale, scale_cov = _fit(table, clock_s, (NONE, FREE, clock_sigma_s))
    of_scale = float(scale_cov[1, 1] + (common / length**2).mean())
    return Biases(
        Bias(float(offset[0]), float(cov[0, 0] + common.mean())),
        Bias(float(scale[1]) * last_m, of_scale * last_m**2),
    )


def clock(differences: Sequence[Difference], sigma_s: float) -> tuple[float, float] | None:
    """The clock's error (s) and its sigma, offset and scale being free; None where the speed was too even to tell."""
    table = np.array(differences).T
    speed, weight, speed_noise = table[2], 1 / table[3], table[5]
    about = speed - weight @ speed / weight.sum()
    if weight @ about**2 <= VARIED * (weight @ speed_noise):
        return None
    fitted, cov = _fit(table, 0.0, (FREE_M, WATERS, sigma_s))
    return float(fitted[2]), float(np.sqrt(cov[2, 2]))


def _fit(table: Array, clock_s: float, sigmas: tuple[float, float, float]) -> tuple[Array, Array]:
    """Offset, scale and clock beyond ``clock_s`` (3,), and their covariance, of differences (6, N).

    Robust least squares (Cauchy's weights, squared), with these sigmas of the three before.
    """
    metres, length, speed, noise = table[:4]
    of, sure = np.stack([np.ones(len(metres)), length, speed]), np.diag(np.array(sigmas) ** -2.0)
    metres, sigma, weight, scale = metres - clock_s * speed, np.sqrt(noise), 1 / noise, 1.0
    fitted, cov = np.zeros(3), sure
    for turn in range(ROUNDS):
        if turn:
            off = np.abs(metres - fitted @ of) / sigma
            scale = max(1.0, 1.4826 * float(np.partition(off, len(off) // 2)[len(off) // 2]))
            weight = 1 / (1 + (off / (TAIL_SIGMAS * scale)) ** 2) ** 2 / noise
        weighted = of * (weight / scale**2)
        before, cov = fitted, np.linalg.inv(weighted @ of.T + sure)
        fitted = cov @ (weighted @ metres)
        if turn and (np.abs(fitted - before) < SETTLED * np.sqrt(np.diagonal(cov))).all():
            break
    return fitted, cov
