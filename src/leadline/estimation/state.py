"""What the filter knows at one time, inside (``State``) and told outside (``Estimate``).

The inner vector is y = (position (3,), shape (k,), velocity (3,), [acceleration (3,)], outline's error, laser clock
tau), so that what measurements see, x = (position, shape), and the velocity are slices. The outline's error counts in
sigmas of ``Measurement.common``. tau: a reading stamped t was taken at t + tau.
"""

from __future__ import annotations

from dataclasses import dataclass

from leadline.estimation.adapt import Noise
from leadline.samples import Array


@dataclass(frozen=True, slots=True)
class Estimate:
    """Target vector x = (position, shape) with covariance, velocity (3,) with covariance, at ``t_ns``."""

    t_ns: int
    x: Array
    cov: Array
    velocity_m_s: Array
    velocity_cov: Array
    laser_clock_s: float
    laser_clock_sigma_s: float


@dataclass(frozen=True, slots=True)
class State:
    """Mean (n,) and covariance (n, n) at ``t_ns``, with k shape parameters, and what is known of the noise.

    turn_rad_s: (3,) the camera's rotation until here, None where it is not measured. refused: laser readings in a row.
    """

    t_ns: int
    y: Array
    P: Array
    k: int
    noise: Noise
    turn_rad_s: Array | None = None
    refused: int = 0

    def estimate(self) -> Estimate:
        d = 3 + self.k
        return Estimate(
            t_ns=self.t_ns,
            x=self.y[:d].copy(),
            cov=self.P[:d, :d].copy(),
            velocity_m_s=self.y[d : d + 3].copy(),
            velocity_cov=self.P[d : d + 3, d : d + 3].copy(),
            laser_clock_s=float(self.y[-1]),
            laser_clock_sigma_s=max(float(self.P[-1, -1]), 0.0) ** 0.5,
        )
