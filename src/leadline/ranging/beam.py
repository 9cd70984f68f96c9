"""The beam as a measurement: what the device says (``reading``), and where its spot is seen (``spot``).

Both are lengths along the same ray from the laser to the target's surface, measured in two independent ways.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import hypot, isfinite

import cv2
import numpy as np

from leadline.config import BeamConfig
from leadline.ranging.beam_image import BeamImage, CalibrationPixels
from leadline.ranging.calibration_error import beam_cov
from leadline.rig import Rig, Side
from leadline.samples import Array, Kind, LaserRange, Measurement, Rejected
from leadline.target import Target

MAX_SLOPE = 1.5  # a beam that grazes the surface says more about the limb than about the distance
TYPICAL_M = 1.0  # where the calibration's error along the beam is taken: offset and scale hardly differ over the range
BLUR_PX = 0.7  # of any lens and sensor
SIDES: tuple[Side, Side] = ("left", "right")
MISFIT = 25.0  # chi-square per degree of freedom beyond which a spot is not the beam's

Seen = Mapping[Side, tuple[Array, Array]]
"""The spot's centre (2,) px and its covariance (2, 2) px^2, in one image or in both."""


@dataclass(frozen=True, slots=True)
class Sought:
    """Where and how the spot must look in one image.

    curve_px: (K, 2) the beam's image, near to far. shape_px2: (2, 2) covariance of its light. facing_px, bend_px (2,):
    why a symmetric spot fitted to its light is not at the beam's middle, see ``middle``. beam_px_m: (2,) how far the
    beam's image runs in a metre, there.
    """

    curve_px: Array
    shape_px2: Array
    facing_px: Array
    bend_px: Array
    beam_px_m: Array

    def middle(self, q_px: Array, spread: float = 1.0) -> Array:
        """The beam's own middle (2,) from the centre of its light: slant and bend move one from the other.

        spread: how far out the light was that gave the centre, as ``Spot`` says; the surface's bend goes with it.
        """
        return np.asarray(q_px - self.facing_px - spread * self.bend_px)


class BeamRanger:
    """For one rig and target."""

    def __init__(self, rig: Rig, target: Target, config: BeamConfig | None = None) -> None:
        if rig.laser is None:
            raise ValueError("the rig has no laser")
        self._target, self._laser = target, rig.laser
        self._config = config or BeamConfig()
        span = self._config.nearest_m, 1.5 * self._config.farthest_m
        self._images = {side: BeamImage(rig, side, *span) for side in SIDES}
        self._calibration = CalibrationPixels(rig, *span)
        offsets = self._config.spot_radius_m * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1], [1, 1]])
        self._parallel = (
            rig.laser.origin_m + offsets @ self._images["left"].across,
            np.tile(rig.laser.direction, (6, 1)),
        )
        reading = rig.laser.raw_m(TYPICAL_M)
        self.calibration_variance_m2 = float(rig.laser.direction @ beam_cov(rig, reading) @ rig.laser.direction)

    def reading(self, sample: LaserRange, extra_sigma_m: float = 0.0) -> Measurement:
        """The raw reading; ``extra_sigma_m`` for a target that moved since."""
        gain = self._laser.range_scale * self._laser.group_index
        sigma = np.hypot(self._laser.range_sigma_m, gain * np.sqrt(extra_sigma_m**2 + self.calibration_variance_m2))
        predict = self._length(self._laser.raw_m, gain)
        return Measurement(Kind.LASER, sample.t_ns, np.array([sample.range_m]), np.array([[sigma**2]]), predict)

    def _length(self, raw: Callable[[float], float], gain: float) -> Callable[[Array], tuple[Array, Array] | None]:
        origin, direction = self._laser.origin_m[None], self._laser.direction[None]

        def predict(x: Array) -> tuple[Array, Array] | None:
            length, gradient = self._target.beam_length(x, origin, direction)
            if not np.isfinite(length[0]) or np.linalg.norm(gradient[0, :3]) > MAX_SLOPE:
                return None
            return np.array([raw(float(length[0]))]), gain * gradient

        return predict

    def sought(self, x: Array, spread: float = 0.2) -> dict[Side, Sought] | None:
        """What to look for when the target is about x, within ``spread`` of its distance; None: the beam misses it."""
        footprint = self._footprint(x)
        if footprint is None:
            return None
        nearest = max((1 - spread) * footprint.length_m, self._config.nearest_m)
        farthest = min(footprint.length_m / (1 - spread), 1.5 * self._config.farthest_m)
        return {side: self._seek(side, footprint, nearest, farthest) for side in SIDES} if farthest > nearest else None

    def _seek(self, side: Side, footprint: _Footprint, nearest_m: float, farthest_m: float) -> Sought:
        image = self._images[side]
        shape_px2, facing_px, bend_px = footprint.in_image(image)
        step_px = max(0.7, 0.5 * float(shape_px2.diagonal().min()) ** 0.5)
        travel_px = hypot(*(image.near(farthest_m)[0] - image.near(nearest_m)[0]).tolist())
        travel_px = travel_px if isfinite(travel_px) else 3000.0  # an end that is unseen
        inverse = np.linspace(1 / nearest_m, 1 / farthest_m, min(int(travel_px / step_px), 3000) + 4)
        return Sought(image.at(1 / inverse), shape_px2, facing_px, bend_px, image.near(footprint.length_m)[1])

    def _footprint(self, x: Array) -> _Footprint | None:
        """Lengths of six parallel rays through the spot: its slant and curvature."""
        radius = self._config.spot_radius_m
        lengths, _ = self._target.beam_length(x, *self._parallel)
        if not np.isfinite(lengths[0]):
            return None
        if not np.isfinite(lengths).all():  # at the limb
            return _Footprint(float(lengths[0]), np.zeros(2), np.zeros((2, 2)), radius / 2)
        d = (lengths - lengths[0]) / radius
        slope = np.array([d[1] - d[2], d[3] - d[4]]) / 2
        pure = np.array([d[1] + d[2], d[3] + d[4]]) / radius
        mixed = (d[5] - slope.sum()) / radius - pure.sum() / 2
        return _Footprint(float(lengths[0]), slope, np.array([[pure[0], mixed], [mixed, pure[1]]]), radius / 2)

    def spot(self, t_ns: int, seen: Seen) -> Measurement | Rejected:
        """The beam's length, maximum likelihood along the beam's image in both cameras, the rig's errors considered.

        A spot that does not lie on the beam's image, or two spots at different lengths, are turned away.
        """
        found = self.solve(seen)
        if found is None:
            return Rejected(Kind.SPOT, t_ns, "cannot be seen there")
        length, variance, chi2, dof = found
        if chi2 > dof * MISFIT:
            return Rejected(Kind.SPOT, t_ns, "is not on the beam", chi2)
        predict = self._length(lambda value: value, 1.0)
        return Measurement(Kind.SPOT, t_ns, np.array([length]), np.array([[variance * max(chi2 / dof, 1.0)]]), predict)

    def solve(self, seen: Seen) -> tuple[float, float, float, int] | None:
        """Length (m), its variance, chi-square of the misfit and its degrees of freedom; None where nothing is seen."""
        sides = [side for side in SIDES if side in seen]
        length = self._images[sides[0]].closest(seen[sides[0]][0])
        if not isfinite(length):
            return None
        weight = np.asarray(cv2.invert(self._pixel_cov(sides, seen, length))[1], np.float64)
        q_px = np.concatenate([seen[side][0] for side in sides])
        information, chi2 = 0.0, 0.0
        for _ in range(4):
            at = [self._images[side].near(length) for side in sides]
            slope = np.concatenate([a[1] for a in at])
            off = q_px - np.concatenate([a[0] for a in at])
            weighted = weight @ slope
            information, chi2 = float(slope @ weighted), float(off @ weight @ off)
            if not information > 0:
                return None
            step = min(max(float(off @ weighted) / information, -0.3 * length), 0.3 * length)
            length += step
            if abs(step) < 1e-7:
                break
        return length, 1 / information, chi2, 2 * len(sides) - 1

    def _pixel_cov(self, sides: list[Side], seen: Seen, length_m: float) -> Array:
        """Of all seen pixels together: their own noise, and the rig's errors, which are common to both."""
        cov = np.zeros((4, 4))
        for i, side in enumerate(SIDES):
            if side in seen:
                cov[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = seen[side][1]
        if not self._calibration.exact:
            cov += self._calibration.at(length_m)
        first, last = 2 * SIDES.index(sides[0]), 2 * SIDES.index(sides[-1]) + 2
        return cov[first:last, first:last]


@dataclass(frozen=True, slots=True)
class _Footprint:
    """The lit surface: length(a) = length_m + slope . a + a . bend . a / 2 for an offset a (2,), m, across the beam."""

    length_m: float
    slope: Array
    bend: Array
    sigma_m: float  # of the light across the beam

    def in_image(self, image: BeamImage) -> tuple[Array, Array, Array]:
        """Of an image: shape (2, 2) px^2 of the light, and the two parts of its lean (2,) px: docs/recognition.md."""
        _, along, sideways = image.near(self.length_m)
        first = sideways + along[:, None] * self.slope
        shape = self.sigma_m**2 * first @ first.T + BLUR_PX**2 * np.eye(2)
        # Second order, q(a) = q0 + first a + half(a, a) / 2: the surface's bend; perspective, where depth shrinks.
        deeper = (image.deeper[:2] + image.deeper[2] * self.slope) / image.depth_m(self.length_m)
        half = along[:, None, None] * self.bend
        half -= first[:, :, None] * deeper + first[:, None, :] * deeper[:, None]
        back = np.asarray(cv2.solve(first, half.reshape(2, 4))[1], np.float64).reshape(2, 2, 2)
        facing = -self.bend @ self.slope / (1 + self.slope @ self.slope)
        turn, swell = back[0, 0] + back[1, 1], back[:, 0, 0] + back[:, 1, 1]
        to_px = self.sigma_m**2 * first
        return shape, to_px @ facing, to_px @ (turn / 2 + swell / 4)
