"""When the sensors measure and when their samples arrive; what the rangefinder reads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from leadline.geometry import Beam
from leadline.samples import NS_PER_S, Array
from leadline.simulation.scenario import CameraPart, LaserPart, VehiclePart

ReadingKind = Literal["target", "backdrop", "early", "outlier", "none"]


@dataclass(frozen=True, slots=True)
class Instant:
    """A measurement at a true time, and when it reaches us."""

    t_ns: int
    arrival_ns: int


def camera_instants(part: CameraPart, duration_s: float, rng: np.random.Generator) -> list[Instant]:
    return _instants(part.rate_hz, part.latency_s, part.jitter_s, duration_s, 0.0, rng)


def laser_instants(part: LaserPart, duration_s: float, rng: np.random.Generator) -> list[Instant]:
    """Its clock is not the camera's trigger: it starts at any time within its first period."""
    start_s = float(rng.uniform(0, 1 / part.rate_hz))
    return _instants(part.rate_hz, part.latency_s, 0.0, duration_s, start_s, rng)


def vehicle_instants(part: VehiclePart, duration_s: float) -> list[Instant]:
    if part.rate_hz == 0:
        return []
    return _instants(part.rate_hz, part.latency_s, 0.0, duration_s, 0.0, np.random.default_rng(0))  # no jitter to draw


def _instants(
    rate_hz: float, latency_s: float, jitter_s: float, duration_s: float, start_s: float, rng: np.random.Generator
) -> list[Instant]:
    count = int((duration_s - start_s) * rate_hz) + 1
    late_s = latency_s + rng.exponential(1.0, count) * jitter_s
    t_ns = [round((start_s + i / rate_hz) * NS_PER_S) for i in range(count)]
    arrivals, latest = [], 0
    for t, late in zip(t_ns, late_s, strict=True):
        latest = max(latest, t + round(float(late) * NS_PER_S))  # a cable keeps the order
        arrivals.append(latest)
    return [Instant(t, arrival) for t, arrival in zip(t_ns, arrivals, strict=True)]


@dataclass(frozen=True, slots=True)
class Reading:
    """What the device says (None: nothing), and why. ``length_m``: what its beam truly met."""

    raw_m: float | None
    quality: float | None
    kind: ReadingKind
    length_m: float | None


class Rangefinder:
    """A time-of-flight device with a threshold: noise, rounding, dropouts, false returns from the water."""

    def __init__(self, beam: Beam, part: LaserPart, attenuation_1_m: float) -> None:
        self._beam, self._part, self._c = beam, part, attenuation_1_m

    def read(self, hit: tuple[float, bool] | None, facing: float, rng: np.random.Generator) -> Reading:
        """``hit``: length and whether on the target; ``facing``: cosine of the beam to the surface's normal."""
        part = self._part
        chance, place, noise, wobble = rng.random(), rng.random(), rng.standard_normal(), rng.uniform(0.95, 1.0)
        length = None if hit is None else hit[0]
        if chance < part.dropouts:
            return Reading(None, None, "none", length)
        if chance < part.dropouts + part.outliers:
            raw = self._beam.raw_m(part.min_m + place * (part.max_m - part.min_m))
            return Reading(self._rounded(raw), round(0.05 + 0.5 * float(rng.random()), 2), "outlier", length)
        way_m = part.max_m if length is None else length
        if rng.random() < 1 - np.exp(-part.early_returns * self._c * way_m):
            early = part.min_m + 0.1 + max(0.0, way_m - part.min_m - 0.15) * place**2
            raw = self._beam.raw_m(early) + part.sigma_m * noise
            return Reading(self._rounded(raw), round(0.1 + 0.4 * float(rng.random()), 2), "early", length)
        if hit is None or not part.min_m <= hit[0] <= part.max_m:
            return Reading(None, None, "none", length)
        signal = np.exp(-2 * self._c * hit[0]) * max(facing, 0.05)
        raw = self._beam.raw_m(hit[0]) + part.sigma_m * noise
        quality = round(float(np.clip(signal**0.2 * wobble, 0, 1)), 2)
        return Reading(self._rounded(raw), quality, "target" if hit[1] else "backdrop", length)

    def _rounded(self, raw_m: float) -> float:
        step = self._part.resolution_m
        return round(round(raw_m / step) * step, 6)


def beam_in_scene(beam: Beam, R_scene_left: Array, t_m: Array) -> tuple[Array, Array]:
    """Origin and direction of the beam in the scene's frame."""
    return R_scene_left @ beam.origin_m + t_m, R_scene_left @ beam.direction
