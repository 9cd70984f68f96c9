"""What would improve a rig most: each change is planned anew, and they are ranked by what they gain."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from leadline.evaluation.plan import Rehearsal, aimed
from leadline.geometry import Pose
from leadline.rig import Rig
from leadline.rig_covariance import RigCovariance

Calibrated = Callable[[Rig, float], Rig]
"""A changed rig with its calibration; the factor says how many times more boards and spots there are."""


@dataclass(frozen=True, slots=True)
class Gain:
    """A change, and the range's sigma, m, at a distance before and after it (filtered, with all that the rig has)."""

    change: str
    distance_m: float
    before_m: float
    after_m: float

    def __str__(self) -> str:
        ends = f"{_mm(self.before_m)} mm to {_mm(self.after_m)} mm at {self.distance_m:g} m"
        return f"{self.change} would bring {ends}"


def _mm(value_m: float) -> str:
    return f"{1e3 * value_m:.2f}" if value_m < 0.00995 else f"{1e3 * value_m:.1f}"


def measured(rig: Rig, more: float) -> Rig:
    """A rig with a covariance of its own: more images of the same kind divide it."""
    cov = rig.covariance
    return dataclasses.replace(rig, covariance=RigCovariance(cov.names, cov.matrix / more))


def ranked(rehearsal: Rehearsal, distance_m: float, calibrated: Calibrated = measured) -> list[Gain]:
    """The best change first; none where the rig sees nothing at that distance."""
    nearest = aimed(rehearsal.rig, distance_m)
    if not np.isfinite(nearest).all():
        return []
    before = rehearsal.cell(nearest).filtered
    if before is None:
        return []
    gains = []
    for change, other in _changes(rehearsal, calibrated):
        there = aimed(other.rig, distance_m)
        after = other.cell(there).filtered if np.isfinite(there).all() else None
        if after is not None:
            gains.append(Gain(change, distance_m, before.range_m, after.range_m))
    return sorted(gains, key=lambda gain: gain.after_m)


def _changes(rehearsal: Rehearsal, calibrated: Calibrated) -> Iterator[tuple[str, Rehearsal]]:
    rig, c, config = rehearsal.rig, rehearsal.conditions, rehearsal.config

    def with_rig(changed: Rig, more: float = 1.0) -> Rehearsal:
        return Rehearsal(calibrated(changed, more), rehearsal.target, c, config)

    T = rig.T_right_left
    yield (
        f"a baseline of {2e3 * rig.baseline_m:.0f} mm",
        with_rig(dataclasses.replace(rig, T_right_left=Pose(T.R, 2 * T.t_m))),
    )
    left, right = (dataclasses.replace(lens, fx=2 * lens.fx, fy=2 * lens.fy) for lens in (rig.left, rig.right))
    yield (
        f"a focal length of {left.fx:.0f} px, with half the field of view,",
        with_rig(dataclasses.replace(rig, left=left, right=right)),
    )
    yield f"images of {2 * rig.left.width}x{2 * rig.left.height}", with_rig(rig.scaled(2.0))
    if rig.covariance.names:
        yield "a calibration with twice the images", with_rig(rig, 2.0)
    if rig.laser is not None:
        laser = dataclasses.replace(rig.laser, range_sigma_m=rig.laser.range_sigma_m / 2)
        yield f"a laser of {1e3 * laser.range_sigma_m:.2g} mm", with_rig(dataclasses.replace(rig, laser=laser))
    for change, changed in (
        ("half the image noise (four times the light)", dataclasses.replace(c, noise_grey=c.noise_grey / 2)),
        ("twice the texture on the target", dataclasses.replace(c, texture_grey_px=2 * c.texture_grey_px)),
        (f"{2 * c.frames_hz:g} frames a second", dataclasses.replace(c, frames_hz=2 * c.frames_hz)),
        (f"{2 * c.readings_hz:g} laser readings a second", dataclasses.replace(c, readings_hz=2 * c.readings_hz)),
    ):
        if rig.laser is not None or "laser" not in change:
            yield change, Rehearsal(rig, rehearsal.target, changed, config)
