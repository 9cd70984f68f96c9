"""The laser in a dive: its readings with what is not known of where the beam meets the target, its spot in a frame.

**A reading while nothing is seen.** The beam's length to a curved surface depends on how far beside its middle the beam
hits. While that is well known, the length is linear in the target's vector. When the target has not been seen for a
while it is not, and a linear filter would take the growing length aside of a ball's front for a growing distance. The
length is then averaged over the sideways uncertainty: its mean, its regression on the vector, and the scatter about
that as noise (statistical linearisation: A. Gelb, "Applied Optimal Estimation", 1974, 6.2), over those places only that
the beam hits, since it did.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from leadline.config import Config
from leadline.estimation import Estimate
from leadline.localizer.motion import Skew
from leadline.ranging.beam import BeamRanger
from leadline.recognition.spot import find_spot
from leadline.rig import Rig, Side
from leadline.samples import NS_PER_S, Array, LaserRange, Measurement, Rejected, StereoFrame
from leadline.target import Target

STRAIGHT = 0.3  # of a reading's sigma: a length that bends by less over one sigma sideways is linear enough
NODES = np.stack(np.meshgrid(*[np.linspace(-2.5, 2.5, 9)] * 2), axis=-1).reshape(-1, 2)  # in sigmas
WEIGHTS = np.exp(-0.5 * (NODES**2).sum(axis=1)) / np.exp(-0.5 * (NODES**2).sum(axis=1)).sum()
LEAST_HIT = 0.05  # of the uncertain places: where fewer are hit, the reading is of something else
STEEPEST = 3.0


class LaserSight:
    """``config``: the run's; readings are kept for frames taken alone."""

    def __init__(self, rig: Rig, target: Target, config: Config) -> None:
        assert rig.laser is not None
        self._rig, self._target, self._config, self._laser = rig, target, config, rig.laser
        self._beam = BeamRanger(rig, target)
        self._readings: deque[LaserRange] = deque(maxlen=32)
        self.calibration_variance_m2 = self._beam.calibration_variance_m2

    def take(self, sample: LaserRange, before: Estimate | None) -> Measurement:
        """The reading as a measurement of the target where it is believed to be."""
        measurement = self._beam.reading(sample)
        return measurement if before is None else self._averaged(measurement, before)

    def keep(self, sample: LaserRange) -> None:
        self._readings.append(sample)

    def last_length_m(self) -> float | None:
        """Of the newest reading."""
        return max(self._laser.length_m(self._readings[-1].range_m), 0.1) if self._readings else None

    def near(self, t_ns: int) -> list[Measurement | Rejected]:
        """The reading nearest in time, less certain by what the target may have moved since; for frames taken alone."""
        near = min(self._readings, key=lambda reading: abs(reading.t_ns - t_ns), default=None)
        if near is None:
            return []
        age_s = abs(near.t_ns - t_ns) / NS_PER_S
        if age_s > self._config.beam.reading_age_s:
            return []
        late_s = np.hypot(age_s, self._config.filter.laser_clock_sigma_s)
        return [self._beam.reading(near, self._config.filter.initial_speed_m_s * float(late_s))]

    def spot(self, frame: StereoFrame, t_ns: int, x: Array, skew: Skew) -> list[Measurement | Rejected]:
        """The spot, where the target as known so far would show it."""
        lengths, gradient = self._lengths(x)
        length = float(lengths)
        if not np.isfinite(length):
            return []
        seen: dict[Side, tuple[Array, Array]] = {}
        config = self._config.beam
        sides: tuple[tuple[Side, object], ...] = (("left", frame.left), ("right", frame.right))
        for side, image in sides:
            _, curve_px = self._beam.curve(side, max(0.8 * length, config.nearest_m), 1.25 * length)
            spot = find_spot(image, curve_px, config.spot_radius_m * self._rig.focal_outside_px / length)  # type: ignore[arg-type]
            if spot is not None:
                seen[side] = (spot.q_px, spot.cov_px2)
        if skew.dt_s and "right" in seen:
            seen["right"] = self._at_left_exposure(*seen["right"], length, gradient[:3], skew)
        return [self._beam.spot(t_ns, seen)] if seen else []

    def _at_left_exposure(
        self, q_px: Array, cov_px2: Array, length_m: float, gradient: Array, skew: Skew
    ) -> tuple[Array, Array]:
        """The right spot's pixel and covariance as they would have been: it ran along the beam meanwhile."""
        point = self._laser.origin_m + length_m * self._laser.direction
        px_per_m = self._rig.project_with_jacobian(point, "right")[1][0] @ self._laser.direction
        ran_m = skew.dt_s * float(gradient @ skew.velocity_m_s)
        sigma_m = skew.dt_s * float(np.sqrt(gradient @ skew.velocity_cov @ gradient))
        along = sigma_m * px_per_m
        return q_px - ran_m * px_per_m, cov_px2 + np.outer(along, along)

    def _lengths(self, x: Array) -> tuple[float, Array]:
        length, gradient = self._target.beam_length(x, self._laser.origin_m[None], self._laser.direction[None])
        return float(length[0]), gradient[0]

    def _averaged(self, measurement: Measurement, before: Estimate) -> Measurement:
        """The measurement, averaged over where beside the beam the target may be, if that matters."""
        gain = self._laser.range_scale * self._laser.group_index
        sides = np.linalg.svd(self._laser.direction[None])[2][1:]  # (2, 3) across the beam
        values, vectors = np.linalg.eigh(sides @ before.cov[:3, :3] @ sides.T)
        spread = (vectors * np.sqrt(np.maximum(values, 1e-12))).T @ sides  # (2, 3): one sigma each
        here, _ = self._lengths(before.x)
        off = [self._lengths(_moved(before.x, s * axis))[0] for axis in spread for s in (-1.0, 1.0)]
        bend = sum(off) / 2 - 2 * here
        if abs(gain * bend) < STRAIGHT * float(np.sqrt(measurement.cov[0, 0])):  # NaN: not straight
            return measurement
        found = [self._lengths(_moved(before.x, node @ spread)) for node in NODES]
        length = np.array([value for value, _ in found])
        hit = np.isfinite(length)
        weight = WEIGHTS[hit]
        if weight.sum() < LEAST_HIT:
            return measurement
        weight = weight / weight.sum()
        terms = np.column_stack([np.ones(hit.sum()), NODES[hit]])
        fit = np.linalg.solve((terms * weight[:, None]).T @ terms + 1e-9 * np.eye(3), terms.T @ (weight * length[hit]))
        scatter = float(weight @ (length[hit] - terms @ fit) ** 2)
        gradient = np.clip(weight @ np.array([g for _, g in found])[hit], -STEEPEST, STEEPEST)
        direction = self._laser.direction
        slope = np.concatenate([(gradient[:3] @ direction) * direction, gradient[3:]])
        slope[:3] += np.linalg.pinv(spread) @ fit[1:]
        x0 = before.x

        def predict(x: Array) -> tuple[Array, Array]:
            return np.array([self._laser.raw_m(float(fit[0] + slope @ (x - x0)))]), gain * slope[None]

        return replace(measurement, cov=measurement.cov + gain**2 * scatter, predict=predict)


def _moved(x: Array, by_m: Array) -> Array:
    moved = x.copy()
    moved[:3] += by_m
    return moved
