"""The beam as a measurement: what the device says (``laser``), and where its spot is seen (``spot``).

Both are lengths along the same ray from the laser to the target's surface, measured in two independent ways.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from leadline.ranging.calibration_error import beam_cov
from leadline.rig import Rig, Side
from leadline.samples import Array, Kind, LaserRange, Measurement, Rejected
from leadline.target import Target

CURVE_STEP_PX = 0.5
MAX_SLOPE = 3.0  # a beam that grazes the surface says more about the limb than about the distance
TYPICAL_M = 1.0  # where the calibration's error along the beam is taken: offset and scale hardly differ over the range


class BeamRanger:
    def __init__(self, rig: Rig, target: Target) -> None:
        if rig.laser is None:
            raise ValueError("the rig has no laser")
        self._rig, self._target, self._laser = rig, target, rig.laser
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

    def curve(self, side: Side, nearest_m: float, farthest_m: float) -> tuple[Array, Array]:
        """Lengths (K,) and pixels (K, 2) of the beam in one image, half a pixel apart; NaN pixels where unseen."""
        ends = 1 / np.linspace(1 / nearest_m, 1 / farthest_m, 64)
        q_px = self._seen(ends, side)
        moved = np.concatenate(
            [[0.0], np.cumsum(np.nan_to_num(np.linalg.norm(np.diff(q_px, axis=0), axis=1), nan=1.0))]
        )
        inverse = np.interp(np.arange(0, moved[-1], CURVE_STEP_PX), moved, 1 / ends)
        lengths = 1 / inverse
        return lengths, self._seen(lengths, side)

    def spot(self, t_ns: int, seen: dict[Side, tuple[Array, Array]]) -> Measurement | Rejected:
        """The beam's length from its spot's pixel (2,) and covariance (2, 2) in one image or both.

        Maximum likelihood along the beam; a spot that does not lie on the beam's image, or two spots at different
        lengths, are turned away.
        """
        length, information, chi2, dof = self._start(seen), 0.0, 0.0, -1
        for _ in range(6):
            information, pull, chi2, dof = 0.0, 0.0, 0.0, -1
            for side, (q_px, cov_px2) in seen.items():
                at_px, jacobian = self._rig.project_with_jacobian(self._point(np.array([length])), camera=side)
                slope = jacobian[0] @ self._laser.direction
                weight = np.linalg.inv(cov_px2)
                off = q_px - at_px[0]
                information += float(slope @ weight @ slope)
                pull += float(slope @ weight @ off)
                chi2 += float(off @ weight @ off)
                dof += 2
            if not information > 0:
                return Rejected(Kind.SPOT, t_ns, "cannot be seen there")
            length += float(np.clip(pull / information, -0.3 * length, 0.3 * length))
        if chi2 > dof * 25:
            return Rejected(Kind.SPOT, t_ns, "is not on the beam", chi2)
        predict = self._length(lambda value: value, 1.0)
        variance = max(chi2 / dof, 1.0) / information
        return Measurement(Kind.SPOT, t_ns, np.array([length]), np.array([[variance]]), predict)

    def _start(self, seen: dict[Side, tuple[Array, Array]]) -> float:
        side, (q_px, _) = next(iter(seen.items()))
        lengths, curve_px = self.curve(side, 0.05, 10.0)
        return float(lengths[np.nanargmin(np.linalg.norm(curve_px - q_px, axis=1))])

    def _point(self, lengths_m: Array) -> Array:
        return np.asarray(self._laser.origin_m + lengths_m[:, None] * self._laser.direction)

    def _seen(self, lengths_m: Array, side: Side) -> Array:
        left, right = self._rig.project(self._point(lengths_m))
        return left if side == "left" else right
