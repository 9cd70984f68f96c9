"""Noise that adapts: to how the target moves, and to the water.

**Motion.** A filter that expects the right motion makes corrections that do not know of each other (R. K. Mehra 1970,
"On the identification of variances and adaptive Kalman filtering"): corrections in a row that point the same way say
that it lags behind, alternating ones that it follows the noise. Each pair moves the logarithm of the power density of
acceleration. Single outliers do not, as they do not come in pairs, nor do constant differences between two sensors.

**Water.** Half of the normalised innovations of a kind lie below their median if its stated noise is right; each moves
the logarithm of that kind's scale up or down by a step (H. Robbins, S. Monro 1951). A few outliers hardly move a
median. Noise is never taken for smaller than stated: part of what is stated is common to all frames and does not show.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, sqrt

from leadline.samples import Array, Kind

MOTION_STEP, MOTION_CLIP = 0.15, 3.0
LEAST, MOST = 0.1, 1000.0  # of the power density in the settings
WATER_STEP, WATER_DOUBT, WATER_MOST = 0.05, 0.3, 3.2  # logarithms of variance; below the doubt nothing is scaled
KINDS = {kind: number for number, kind in enumerate(Kind)}


@dataclass(frozen=True, slots=True)
class Noise:
    """acceleration_psd in m^2/s^3; log_scale by kind; last: the last correction, in its own sigmas."""

    acceleration_psd: float
    log_scale: tuple[float, ...] = (0.0,) * len(KINDS)
    last: tuple[float, float, float] | None = None

    def scale(self, kind: Kind) -> float:
        """Of the variance that measurements of this kind state: 1 or more."""
        return exp(max(self.log_scale[KINDS[kind]] - WATER_DOUBT, 0.0))

    def after_innovation(self, kind: Kind, nis: float, dof: int) -> Noise:
        """nis: the innovation's normalised square, with the scale in it."""
        spread = 2 / (9 * dof)
        step = WATER_STEP if nis > dof * (1 - spread) ** 3 else -WATER_STEP
        logs = list(self.log_scale)
        logs[KINDS[kind]] = min(max(logs[KINDS[kind]] + step, 0.0), WATER_MOST)
        return Noise(self.acceleration_psd, tuple(logs), self.last)

    def after_correction(self, moved_m: Array, before: Array, after: Array, usual_psd: float) -> Noise:
        """moved_m (3,): how far an instant's measurements moved the position; its covariance before and after them."""
        now = _in_sigmas(moved_m.tolist(), (before * (1 + 1e-9) - after).tolist())
        if now is None:
            return self
        psd = self.acceleration_psd
        if self.last is not None:
            alike = sum(a * b for a, b in zip(now, self.last, strict=True)) / 3
            psd = min(max(psd * exp(MOTION_STEP * alike), LEAST * usual_psd), MOST * usual_psd)
        return Noise(psd, self.log_scale, now)


def _in_sigmas(v: list[float], C: list[list[float]]) -> tuple[float, float, float] | None:
    """L^-1 v with C = L L', clipped: by hand, as this runs for every frame. None where C is no covariance."""
    if C[0][0] <= 0:
        return None
    l00 = sqrt(C[0][0])
    l10, l20 = C[1][0] / l00, C[2][0] / l00
    d1 = C[1][1] - l10 * l10
    if d1 <= 0:
        return None
    l11 = sqrt(d1)
    l21 = (C[2][1] - l20 * l10) / l11
    d2 = C[2][2] - l20 * l20 - l21 * l21
    if d2 <= 0:
        return None
    e0 = v[0] / l00
    e1 = (v[1] - l10 * e0) / l11
    e2 = (v[2] - l20 * e0 - l21 * e1) / sqrt(d2)
    return (
        max(-MOTION_CLIP, min(MOTION_CLIP, e0)),
        max(-MOTION_CLIP, min(MOTION_CLIP, e1)),
        max(-MOTION_CLIP, min(MOTION_CLIP, e2)),
    )
