"""Noise that adapts: to how the target moves, and to the water.

**Motion.** A filter that expects the right motion makes corrections that do not know of each other (R. K. Mehra 1970,
"On the identification of variances and adaptive Kalman filtering"): corrections that go on pointing the same way say
that it lags behind, alternating ones that it follows the noise. The cosine between a correction and those before it,
in their own sigmas, moves the logarithm of the power density of acceleration. Single outliers do not, as they have no
company, nor do constant differences between two sensors, nor noise that is stated too small or large.

**Water.** Half of the normalised innovations of a kind lie below their median if its stated noise is right; each moves
the logarithm of that kind's scale up or down by a step (H. Robbins, S. Monro 1951). A few outliers hardly move a
median. Noise is never taken for smaller than stated: part of what is stated is common to all frames and does not show.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, sqrt

from leadline.estimation.small import cholesky
from leadline.samples import Array, Kind

MOTION_STEP, MEMORY = 0.1, 0.6  # of the logarithm; of the corrections before, from one to the next
LEFT = 0.04  # alike they are with the right noise, as robust updates leave a little of an error to the next
LARGE, FASTEST = 4.0, 6.0  # aligned corrections larger than these sigmas squared count more, up to so many times
LEAST, MOST = 0.01, 100.0  # of the power density in the settings
WATER_STEP, WATER_DOUBT, WATER_MOST = 0.02, 0.3, 3.2  # logarithms of variance; below the doubt nothing is scaled
KINDS = {kind: number for number, kind in enumerate(Kind)}


@dataclass(frozen=True, slots=True)
class Noise:
    """acceleration_psd in m^2/s^3; log_scale by kind; trend: the corrections so far, in their sigmas."""

    acceleration_psd: float
    log_scale: tuple[float, ...] = (0.0,) * len(KINDS)
    trend: tuple[float, float, float] | None = None

    def scale(self, kind: Kind) -> float:
        """Of the variance that measurements of this kind state: 1 or more."""
        return exp(max(self.log_scale[KINDS[kind]] - WATER_DOUBT, 0.0))

    def after_innovation(self, kind: Kind, nis: float, dof: int) -> Noise:
        """nis: the innovation's normalised square, with the scale in it."""
        spread = 2 / (9 * dof)
        step = WATER_STEP if nis > dof * (1 - spread) ** 3 else -WATER_STEP
        logs = list(self.log_scale)
        logs[KINDS[kind]] = min(max(logs[KINDS[kind]] + step, 0.0), WATER_MOST)
        return Noise(self.acceleration_psd, tuple(logs), self.trend)

    def after_correction(self, moved_m: Array, before: Array, after: Array, usual_psd: float) -> Noise:
        """moved_m (3,): how far an instant's measurements moved the position; its covariance before and after them."""
        now = _in_sigmas(moved_m.tolist(), (before * (1 + 1e-9) - after).tolist())
        if now is None:
            return self
        if self.trend is None:
            return Noise(self.acceleration_psd, self.log_scale, now)
        (x, y, z), (tx, ty, tz) = now, self.trend
        size = sqrt((x * x + y * y + z * z) * (tx * tx + ty * ty + tz * tz)) + 1e-12
        alike = (x * tx + y * ty + z * tz) / size * min(max(size / LARGE, 1.0), FASTEST)
        psd = min(max(self.acceleration_psd * exp(MOTION_STEP * (alike - LEFT)), LEAST * usual_psd), MOST * usual_psd)
        return Noise(psd, self.log_scale, (MEMORY * tx + x, MEMORY * ty + y, MEMORY * tz + z))


def _in_sigmas(v: list[float], C: list[list[float]]) -> tuple[float, float, float] | None:
    """L^-1 v with C = L L'; None where C is no covariance."""
    factor = cholesky((C[0][0], C[1][0], C[1][1], C[2][0], C[2][1], C[2][2]))
    if factor is None:
        return None
    a, b, c, d, e, f = factor
    x = v[0] / a
    y = (v[1] - b * x) / c
    return x, y, (v[2] - d * x - e * y) / f
