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
ROUNDS = 8
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
    last_m = differences[-1].length_m
    common, length = np.array([(one.common_m2, one.length_m) for one in differences]).T
    offset, cov, _ = _fit(differences, clock_s, (FREE_M, NONE, clock_sigma_s))
    scale, scale_cov, _ = _fit(differences, clock_s, (NONE, FREE, clock_sigma_s))
    of_scale = float(scale_cov[1, 1] + (common / length**2).mean())
    return Biases(
        Bias(float(offset[0]), float(cov[0, 0] + common.mean())),
        Bias(float(scale[1]) * last_m, of_scale * last_m**2),
    )


def clock(differences: Sequence[Difference], sigma_s: float) -> tuple[float, float] | None:
    """The clock's error (s) and its sigma, offset and scale being free; None where the speed was too even to tell."""
    fitted, cov, weight = _fit(differences, 0.0, (FREE_M, WATERS, sigma_s))
    speed, noise = np.array([(one.speed_m_s, one.speed_noise) for one in differences]).T
    about = speed - weight @ speed / weight.sum()
    if weight @ about**2 <= VARIED * (weight @ noise):
        return None
    return float(fitted[2]), float(np.sqrt(cov[2, 2]))


def _fit(
    differences: Sequence[Difference], clock_s: float, sigmas: tuple[float, float, float]
) -> tuple[Array, Array, Array]:
    """Offset, scale and clock beyond ``clock_s`` (3,), their covariance, and the weights (N,).

    Robust least squares (Cauchy's weights, squared), with these sigmas of the three before.
    """
    metres, length, speed, noise = np.array(differences).T[:4]
    of = np.stack([np.ones(len(metres)), length, speed])
    metres, sure, weight = metres - clock_s * speed, np.diag(np.array(sigmas) ** -2.0), 1 / noise
    fitted = np.zeros(3)
    for i in range(ROUNDS):
        off = np.abs(metres - fitted @ of) / np.sqrt(noise)
        scale = max(1.0, 1.4826 * float(np.median(off))) if i else 1.0
        if i:
            weight = 1 / (1 + (off / (TAIL_SIGMAS * scale)) ** 2) ** 2 / noise
        weighted = of * (weight / scale**2)
        cov = np.linalg.inv(weighted @ of.T + sure)
        fitted = cov @ (weighted @ metres)
    return fitted, cov, weight
