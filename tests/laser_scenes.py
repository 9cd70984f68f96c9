"""Stations and painted dives of a known laser, for the tests of its calibration."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from leadline.calibration.laser import LASER
from leadline.calibration.spots import Station
from leadline.recognition.spot import Spot
from leadline.rig import Rig
from leadline.rig_parameters import get, replaced
from leadline.samples import NS_PER_S, Array, Image, LaserRange, Sample, StereoFrame

AIR_Z_M = (0.5, 0.8, 1.1, 1.4, 1.7, 2.0, 2.5)
MATCH_NOISE_PX = 0.06
WATER_Z_M = (0.5, 0.7, 0.9, 1.1, 1.3, 1.5, 1.7, 1.9, 2.1, 2.2)


def truth_rig() -> Rig:
    return Rig.load("rendered")


def air_rig(rig: Rig | None = None) -> Rig:
    """The same cameras and laser in air, without the housing."""
    rig = truth_rig() if rig is None else rig
    laser = None if rig.laser is None else dataclasses.replace(rig.laser, group_index=1.0)
    return dataclasses.replace(rig, port=None, water=None, laser=laser)


def spot_points(rig: Rig, z_m: Sequence[float]) -> tuple[Array, Array]:
    """Lengths (N,) and lit points (N, 3) on walls at z."""
    assert rig.laser is not None
    lengths = (np.array(z_m) - rig.laser.origin_m[2]) / rig.laser.direction[2]
    return lengths, rig.laser.origin_m + lengths[:, None] * rig.laser.direction


def stations(
    rig: Rig,
    z_m: Sequence[float],
    rng: np.random.Generator,
    *,
    sigma_px: float = 0.1,
    readings: int = 10,
    matches: int = 0,
) -> list[Station]:
    """What a perfect search would find: spots with noise, means of noisy readings, matches over the view."""
    assert rig.laser is not None
    lengths, points = spot_points(rig, z_m)
    left, right = rig.project(points)
    out = []
    for i, length in enumerate(lengths):
        raw = rig.laser.raw_m(float(length)) + rig.laser.range_sigma_m * rng.normal(size=readings)
        seen = [Spot(q[i] + sigma_px * rng.normal(size=2), sigma_px**2 * np.eye(2), 30.0) for q in (left, right)]
        out.append(Station(f"{i}.png", seen[0], seen[1], float(raw.mean()), readings, float(raw.std(ddof=1))))
    for i, z in enumerate(z_m if matches else ()):
        wall = z * np.stack(
            [rng.uniform(-0.3, 0.3, matches), rng.uniform(-0.2, 0.2, matches), np.ones(matches)], axis=1
        )
        seen_px = np.hstack(rig.project(wall)) + MATCH_NOISE_PX * rng.normal(size=(matches, 4))
        out[i] = dataclasses.replace(out[i], matches_px=seen_px)
    return out


def lit_points_nees(found: Rig, truth: Rig) -> float:
    """Squared error of the points lit at three readings over their covariance, for each of its dimensions.

    Six of nine are free (line 4, scale, offset): what one medium shows of a laser.
    """
    names = LASER if truth.water is None else (*LASER, "water.group_index")

    def points(rig: Rig, values: Array) -> Array:
        beam = replaced(rig, names, values).laser
        assert beam is not None
        return np.concatenate([beam.point_m(raw) for raw in (0.7, 1.7, 2.7)])

    here = get(found, names)
    steps = np.eye(len(names)) * 1e-6
    jacobian = np.stack([(points(found, here + e) - points(found, here - e)) / 2e-6 for e in steps], axis=1)
    variances, axes = np.linalg.eigh(jacobian @ found.covariance.of(names) @ jacobian.T)
    free = variances > 1e-5 * variances[-1]
    error = axes[:, free].T @ (points(found, here) - points(truth, get(truth, names)))
    return float(np.mean(error**2 / variances[free]))


def painted_dive(rig: Rig, z_m: Sequence[float], seed: int = 0) -> Iterator[Sample]:
    """A static dive: grey walls with a green spot, three readings a second for four seconds around each frame."""
    rng = np.random.default_rng(seed)
    assert rig.laser is not None
    lengths, points = spot_points(rig, z_m)
    left, right = rig.project(points)
    for i, length in enumerate(lengths):
        t_s = 10.0 * i
        radius = 0.003 * rig.left.fx / z_m[i]
        images = [_wall(rig, q[i], radius, rng) for q in (left, right)]
        yield StereoFrame(round(t_s * NS_PER_S), images[0], images[1], name=f"left_{i:02d}.png")
        for k in range(-5, 6):
            raw = rig.laser.raw_m(float(length)) + 0.003 * rng.normal()
            yield LaserRange(round((t_s + k / 3) * NS_PER_S), round(raw, 3))


def _wall(rig: Rig, q_px: Array, radius_px: float, rng: np.random.Generator) -> Image:
    image = np.full((rig.left.height, rig.left.width, 3), 120, np.uint8)
    cv2.rectangle(image, (500, 200), (1400, 900), (170, 180, 170), -1)
    u, v = np.meshgrid(np.arange(rig.left.width) - q_px[0], np.arange(rig.left.height) - q_px[1], sparse=True)
    light = np.exp(-2 * (u / radius_px) ** 2) * np.exp(-2 * (v / radius_px) ** 2)  # a laser's: no edge, cut off on top
    image = np.minimum(image + 200 * light[..., None] * [0.1, 1.0, 0.05], 255)
    noise = rng.normal(size=(rig.left.height // 4, rig.left.width // 4, 1)) * 6
    noisy = image + cv2.resize(noise, (rig.left.width, rig.left.height))[..., None]
    return np.clip(noisy, 0, 255).astype(np.uint8)
