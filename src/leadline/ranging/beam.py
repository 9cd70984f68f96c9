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
        step_px = max(0.7, 0.5 * float(min(shape_px2[0, 0], shape_px2[1, 1])) ** 0.5)
        (x0, y0, _, _), (x1, y1, _, _) = image.near(nearest_m), image.near(farthest_m)
        travel_px = hypot(x1 - x0, y1 - y0)
        travel_px = travel_px if isfinite(travel_px) else 3000.0  # an end that is unseen
        count = min(int(travel_px / step_px), 3000) + 4
        apart = (1 / farthest_m - 1 / nearest_m) / (count - 1)
        curve_px = image.at(1 / (1 / nearest_m + apart * np.arange(count)))
        return Sought(curve_px, shape_px2, facing_px, bend_px, np.array(image.near(footprint.length_m)[2:]))

    def _footprint(self, x: Array) -> _Footprint | None:
        """Lengths of six parallel rays through the spot: its slant and curvature."""
        radius = self._config.spot_radius_m
        lengths: list[float] = self._target.beam_length(x, *self._parallel)[0].tolist()
        if not isfinite(lengths[0]):
            return None
        if not all(isfinite(length) for length in lengths):  # at the limb
            return _Footprint(lengths[0], (0.0, 0.0), (0.0, 0.0, 0.0), radius / 2)
        a, minus_a, b, minus_b, both = ((length - lengths[0]) / radius for length in lengths[1:])
        slope = (a - minus_a) / 2, (b - minus_b) / 2
        pure = (a + minus_a) / radius, (b + minus_b) / radius
        mixed = (both - sum(slope)) / radius - sum(pure) / 2
        return _Footprint(lengths[0], slope, (pure[0], mixed, pure[1]), radius / 2)

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
        fit = self._fit(seen)
        return None if fit is None else (fit.length_m, 1 / fit.information, fit.chi2, len(fit.off) - 1)

    def centres(self, seen: Seen) -> dict[Side, tuple[Array, Array]] | None:
        """The beam's middle in each image that shows it, by all of them and by the beam's own image: q_px (2,) and its
        covariance (2, 2) px^2. Off the beam's image only as far as the rig is uncertain; None as in ``solve``."""
        fit = self._fit(seen)
        if fit is None:
            return None
        told = fit.rig_px2 @ fit.weight  # how much of what lies off the beam's image is the rig's error
        q_px = fit.on_px + told @ fit.off
        open_px = fit.slope - told @ fit.slope
        cov = fit.rig_px2 - told @ fit.rig_px2 + np.outer(open_px, open_px) / fit.information
        sides = [side for side in SIDES if side in seen]
        return {side: (q_px[i : i + 2], cov[i : i + 2, i : i + 2]) for i, side in zip((0, 2), sides, strict=False)}

    def _fit(self, seen: Seen) -> _OnBeam | None:
        sides = [side for side in SIDES if side in seen]
        images = [self._images[side] for side in sides]
        length = images[0].closest(seen[sides[0]][0])
        if not isfinite(length):
            return None
        rig_px2 = self._rig_px2(sides, length)
        cov = rig_px2.copy()
        for i, side in enumerate(sides):
            cov[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += seen[side][1]
        weight = np.asarray(cv2.invert(cov)[1], np.float64)
        q_px = np.concatenate([seen[side][0] for side in sides])
        for _ in range(4):
            at = [image.near(length) for image in images]
            on_px, slope = np.array([a[:2] for a in at]).ravel(), np.array([a[2:] for a in at]).ravel()
            off = q_px - on_px
            weighted = weight @ slope
            information = float(slope @ weighted)
            if not information > 0:
                return None
            step = min(max(float(off @ weighted) / information, -0.3 * length), 0.3 * length)
            length += step
            if abs(step) < 1e-7:
                break
        return _OnBeam(length, information, on_px, slope, off, weight, rig_px2)

    def _rig_px2(self, sides: list[Side], length_m: float) -> Array:
        """Of all seen pixels together: the rig's errors, which are common to both images."""
        first, last = 2 * SIDES.index(sides[0]), 2 * SIDES.index(sides[-1]) + 2
        whole = np.zeros((4, 4)) if self._calibration.exact else self._calibration.at(length_m)
        return whole[first:last, first:last]


@dataclass(frozen=True, slots=True)
class _OnBeam:
    """The place on the beam's image nearest to what is seen; n is 2 for each image."""

    length_m: float
    information: float
    on_px: Array  # (n,)
    slope: Array  # (n,) d(on)/d(length)
    off: Array  # (n,) seen less on
    weight: Array  # (n, n)
    rig_px2: Array  # (n, n)

    @property
    def chi2(self) -> float:
        return float(self.off @ self.weight @ self.off)


@dataclass(frozen=True, slots=True)
class _Footprint:
    """The lit surface: length(a) = length_m + slope . a + a . bend . a / 2 for an offset a (2,), m, across the beam.

    In plain numbers: for matrices as small as these the library's calls would cost more than all else.
    """

    length_m: float
    slope: tuple[float, float]
    bend: tuple[float, float, float]  # of a0 a0, a0 a1, a1 a1
    sigma_m: float  # of the light across the beam

    def in_image(self, image: BeamImage) -> tuple[Array, Array, Array]:
        """Of an image: shape (2, 2) px^2 of the light, and the two parts of its lean (2,) px: docs/recognition.md."""
        (s, t), (b00, b01, b11), variance = self.slope, self.bend, self.sigma_m**2
        _, _, u, v = image.near(self.length_m)
        (u0, u1), (v0, v1) = image.sideways(self.length_m)
        u0, u1, v0, v1 = u0 + u * s, u1 + u * t, v0 + v * s, v1 + v * t  # J: d(pixel)/d(offset) on the surface
        xx, xy, yy = u0 * u0 + u1 * u1, u0 * v0 + u1 * v1, v0 * v0 + v1 * v1
        shape = variance * np.array([[xx, xy], [xy, yy]])
        shape.ravel()[::3] += BLUR_PX**2
        slant = 1 + s * s + t * t
        facing = -(b00 * s + b01 * t) / slant, -(b01 * s + b11 * t) / slant
        # Second order, q(a) = q0 + J a + H(a, a) / 2: the surface's bend; perspective, where depth shrinks. In J's own
        # coordinates K_lab = w_l bend_ab - (d_la deeper_b + d_lb deeper_a), of which the two traces are wanted.
        across, depth = image.deeper, image.depth_m(self.length_m)
        deeper = (across[0] + across[2] * s) / depth, (across[1] + across[2] * t) / depth
        flat = u0 * v1 - u1 * v0
        w0, w1 = (v1 * u - u1 * v) / flat, (u0 * v - v0 * u) / flat
        trace = (b00 + b11) / 4
        lean = [
            (w0 * b00 + w1 * b01) / 2 + w0 * trace - 2 * deeper[0],
            (w0 * b01 + w1 * b11) / 2 + w1 * trace - 2 * deeper[1],
        ]
        facing_px, bend_px = (variance * np.array([u0 * a + u1 * b, v0 * a + v1 * b]) for a, b in (facing, lean))
        return shape, facing_px, bend_px
