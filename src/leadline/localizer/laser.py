"""The laser in a dive: its readings as measurements of the target, its spot in a frame."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from leadline.config import Config
from leadline.estimation import Estimate
from leadline.localizer.agreement import Length
from leadline.localizer.blind import Aside
from leadline.localizer.motion import Skew
from leadline.ranging.beam import BeamRanger, Sought
from leadline.ranging.calibration_error import CalibrationError
from leadline.recognition.dark import aligned, around
from leadline.recognition.spot import NoSpot, Spot, find_spot
from leadline.rig import Rig, Side
from leadline.samples import NS_PER_S, Array, Image, Kind, LaserRange, Measurement, Rejected, StereoFrame
from leadline.target import Surface, Target

DARK_AGE_S = 0.3  # of the frame without the laser, to be subtracted


class LaserSight:
    """``config``: the run's; readings are kept for frames taken alone."""

    def __init__(self, rig: Rig, target: Target, config: Config) -> None:
        assert rig.laser is not None
        self._rig, self._target, self._config, self._laser = rig, target, config, rig.laser
        self._beam = BeamRanger(rig, target, config.beam)
        self._readings: deque[LaserRange] = deque(maxlen=32)
        self._dark: StereoFrame | None = None
        self._aside: tuple[Estimate, Aside] | None = None  # the last, which is asked for again
        self.calibration_variance_m2 = self._beam.calibration_variance_m2

    def take(self, sample: LaserRange, unseen: Aside | None) -> Measurement:
        """The reading as a measurement of the target; ``unseen``: where it may be that nobody sees."""
        return self.blindly(self._beam.reading(sample), unseen)

    def blindly(self, measurement: Measurement, unseen: Aside | None) -> Measurement:
        """A reading or a spot while the target itself is not seen."""
        if unseen is None or not unseen.is_hit:
            return measurement
        is_raw = measurement.kind is Kind.LASER
        gain = self._laser.range_scale * self._laser.group_index if is_raw else 1.0

        def predict(x: Array) -> tuple[Array, Array] | None:
            length, gradient = unseen.length(x)
            if not np.isfinite(length):
                return None
            return np.array([self._laser.raw_m(length) if is_raw else length]), gain * gradient[None]

        return replace(measurement, predict=predict)

    def aside(self, believed: Estimate) -> Aside:
        """What a beam tells of a target that is not seen."""
        if self._aside is None or self._aside[0] is not believed:
            self._aside = believed, Aside(self._target, self._laser, believed)
        return self._aside[1]

    def length(self, sample: LaserRange) -> Length:
        """The beam's length by the device."""
        gain = self._laser.range_scale * self._laser.group_index
        noise = (self._laser.range_sigma_m / gain) ** 2
        return Length(sample.t_ns, self._laser.length_m(sample.range_m), noise, self.calibration_variance_m2)

    def length_by(self, seen: Measurement, calibration: CalibrationError) -> Length | None:
        """The beam's length by what a frame shows; None where the beam passes the target by."""
        if seen.kind is Kind.SPOT:
            length, noise, shape = float(seen.z[0]), float(seen.cov[0, 0]), 0.0
        else:
            length, gradient = self._lengths(seen.z)
            noise = float(gradient @ seen.cov @ gradient)
            shape = self._of_shape(gradient, seen.cov)
        if not (np.isfinite(length) and np.isfinite(noise)) or length < self._config.beam.nearest_m:
            return None
        point_m = self._laser.origin_m + length * self._laser.direction
        common = float(self._laser.direction @ calibration.at(point_m) @ self._laser.direction)
        return Length(seen.t_ns, length, noise - shape, common, shape)

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
        """The spot, where the target as known so far would show it; a frame without the laser is kept for the next."""
        if frame.laser_on is False:
            self._dark = frame
            return []
        sought = self._beam.sought(x)
        if sought is None:
            return []
        seen: dict[Side, tuple[Array, Array]] = {}
        missing: dict[str, None] = {}
        sides: tuple[tuple[Side, Image], ...] = (("left", frame.left), ("right", frame.right))
        for side, image in sides:
            found = self._find(image, sought[side], self._dark_for(frame, side))
            if isinstance(found, Spot):
                seen[side] = sought[side].middle(found.q_px, found.spread), found.cov_px2
            else:
                missing[found.reason] = None
        if not seen:
            return [Rejected(Kind.SPOT, t_ns, "; ".join(missing))]
        if skew.dt_s and "right" in seen:
            length, gradient = self._lengths(x)
            seen["right"] = self._at_left_exposure(*seen["right"], length, gradient[:3], skew)
        both = self._beam.spot(t_ns, seen)
        if isinstance(both, Measurement) and len(seen) == 2:
            return [both]
        return [self._by_one_camera(t_ns, side, seen) for side in seen]  # alone, or they contradict each other

    def _by_one_camera(self, t_ns: int, side: Side, seen: Mapping[Side, tuple[Array, Array]]) -> Measurement | Rejected:
        spot = self._beam.spot(t_ns, {side: seen[side]})
        return replace(spot, cameras=frozenset({side})) if isinstance(spot, Measurement) else spot

    def _dark_for(self, frame: StereoFrame, side: Side) -> Image | None:
        """The other frame's picture, where one without the laser was taken just before."""
        dark = self._dark
        if not frame.laser_on or dark is None or abs(frame.t_ns - dark.t_ns) > DARK_AGE_S * NS_PER_S:
            return None
        return dark.left if side == "left" else dark.right

    @staticmethod
    def _find(image: Image, sought: Sought, dark: Image | None) -> Spot | NoSpot:
        part = None if dark is None or dark.shape != image.shape else around(sought.curve_px, image.shape[:2])
        if dark is None or part is None:
            return find_spot(image, sought.curve_px, sought.shape_px2, sought.beam_px_m)
        corner_px = np.array([part[1].start, part[0].start], float)
        bare = aligned(dark[part], image[part])
        found = find_spot(image[part], sought.curve_px - corner_px, sought.shape_px2, sought.beam_px_m, bare)
        return replace(found, q_px=found.q_px + corner_px) if isinstance(found, Spot) else found

    def _at_left_exposure(
        self, q_px: Array, cov_px2: Array, length_m: float, gradient: Array, skew: Skew
    ) -> tuple[Array, Array]:
        """The right spot's pixel and covariance as they would have been: it ran along the beam meanwhile."""
        point = self._laser.origin_m + length_m * self._laser.direction
        px_per_m = self._rig.project_with_jacobian(point[None], "right")[1][0] @ self._laser.direction
        ran_m = skew.dt_s * float(gradient @ skew.velocity_m_s)
        sigma_m = skew.dt_s * float(np.sqrt(gradient @ skew.velocity_cov @ gradient))
        along = sigma_m * px_per_m
        return q_px - ran_m * px_per_m, cov_px2 + np.outer(along, along)

    def _of_shape(self, gradient: Array, cov: Array) -> float:
        """The part of its variance that is how far behind an unknown surface the beam goes: alike in all frames."""
        if not isinstance(self._target, Surface):
            return 0.0
        return float(gradient @ cov @ gradient - gradient[:3] @ cov[:3, :3] @ gradient[:3])

    def _lengths(self, x: Array) -> tuple[float, Array]:
        length, gradient = self._target.beam_length(x, self._laser.origin_m[None], self._laser.direction[None])
        return float(length[0]), gradient[0]
