"""What one frame says of the target: outline, stereo and spot, each from the best idea of it so far."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from leadline.config import Config
from leadline.estimation import Estimate
from leadline.estimation.small import chi_square
from leadline.localizer.laser import LaserSight
from leadline.localizer.motion import Skew, taken_ns
from leadline.ranging.calibration_error import CalibrationError
from leadline.ranging.coarse import Box
from leadline.ranging.outline import OutlineRanger
from leadline.ranging.stereo import Pair, Prior, StereoRanger
from leadline.rig import Rig
from leadline.samples import Array, Kind, Measurement, Rejected, StereoFrame
from leadline.target import Sphere, Target, is_known_ball, range_with_sigma

POOR = 0.1  # a range less certain than this part of itself is no prediction
APART = 40.0  # chi-square of three numbers: two measurements that are not of one place
FAR_SINE = 0.005  # of half the angle that a ball is seen under: smaller ones are not believed
VISION = frozenset({Kind.STEREO, Kind.SIZE})
BOTH = frozenset({"left", "right"})
Found = list[Measurement | Rejected]
Size = Measurement | Rejected | None  # None: of what has no outline, or has no size yet


class Counted:
    """What a filter's covariance holds of the calibration's error, which is in every measurement of vision.

    The filter takes it for noise of each frame, though it is that of all: of its variance c along a direction, k^2 c is
    in the estimate by a frame that is taken with the gain k. Whoever adds the calibration for good takes this out.
    """

    def __init__(self) -> None:
        self._share = self._variance = np.zeros(2)

    def take(self, found: Sequence[Measurement], calibration: Array, before: Estimate | None, after: Estimate) -> None:
        """Those that were used of a frame, and the estimate before and after."""
        p_m2 = along_and_across(after.x, after.cov)
        told = sum((1 / along_and_across(after.x, one.cov) for one in found), np.zeros(2))
        learnt = 1 / p_m2 if before is None else 1 / p_m2 - 1 / along_and_across(after.x, before.cov)
        gain = np.clip(p_m2 * np.minimum(told, learnt), 0.0, 1.0)
        self._variance = gain**2 * along_and_across(after.x, calibration)
        self._share = np.minimum(self._variance / p_m2, 1.0)

    def without(self, estimate: Estimate) -> Array:
        """The estimate's covariance (3 + k, 3 + k) without it; the share only falls as the estimate is predicted."""
        share = np.minimum(self._share, self._variance / along_and_across(estimate.x, estimate.cov))
        kept = np.sqrt(1 - share)
        sight = estimate.x[:3] / np.linalg.norm(estimate.x[:3])
        shrunk = np.eye(len(estimate.x))
        shrunk[:3, :3] = kept[1] * np.eye(3) + (kept[0] - kept[1]) * np.outer(sight, sight)
        return np.asarray(shrunk @ estimate.cov @ shrunk)


def along_and_across(x: Array, cov: Array) -> Array:
    """(2,) variance of a position along the line of sight, and across it on average."""
    along = float(x[:3] @ cov[:3, :3] @ x[:3] / (x[:3] @ x[:3]))
    return np.array([along, (np.trace(cov[:3, :3]) - along) / 2])


class Sight:
    """``laser``: whose spot is looked for, where the rig has one."""

    def __init__(self, rig: Rig, target: Target, config: Config, laser: LaserSight | None) -> None:
        self._rig, self._target, self._laser = rig, target, laser
        self._stereo = StereoRanger(rig, target, config.stereo)
        self._outline = OutlineRanger(target, config.outline) if isinstance(target, Sphere) else None
        self.calibration = CalibrationError(rig)

    def measure(self, frame: StereoFrame, box: Box, before: Estimate | None, skew: Skew) -> Found:
        """All that one frame says, at its left exposure."""
        pair = Pair(frame.left, frame.right, skew.rig(self._rig))
        guess = self._prior(before)
        found = self._see(taken_ns(frame), pair, box, guess)
        places = [one for one in found if isinstance(one, Measurement)]
        x = places[0].z if places else guess.x if guess is not None else self._idea(box)
        found = [self._honest(one, skew) if isinstance(one, Measurement) else one for one in found]
        return found if self._laser is None else found + self._laser.spot(frame, taken_ns(frame), x, skew)

    def spot(self, frame: StereoFrame, before: Estimate | None, skew: Skew) -> Found:
        """The spot alone, on a target that is believed and not seen."""
        guess = self._prior(before)
        if self._laser is None or guess is None:
            return []
        return self._laser.spot(frame, taken_ns(frame), guess.x, skew)

    def beam_px(self) -> tuple[float, float] | None:
        """Where in the left image the last reading says that the beam ends; None without one."""
        length_m = None if self._laser is None else self._laser.last_length_m()
        if length_m is None or self._rig.laser is None:
            return None
        end_m = self._rig.laser.origin_m + length_m * self._rig.laser.direction
        u, v = self._rig.project_one(end_m[None], "left")[0]
        return float(u), float(v)

    def _prior(self, before: Estimate | None) -> Prior | None:
        if before is None:
            return None
        guess = Prior(before.x, range_with_sigma(self._target, before.x, before.cov)[1])
        return None if guess.range_sigma_m > POOR * np.linalg.norm(guess.x[:3]) else guess

    def _honest(self, measurement: Measurement, skew: Skew) -> Measurement:
        """What vision measures is no better than its calibration: it must not turn the laser away for that."""
        cov = measurement.cov.copy()
        cov[:3, :3] += self.calibration.at(measurement.z[:3])
        triangulated = measurement.kind is Kind.STEREO or not is_known_ball(self._target)
        cameras = BOTH if triangulated else measurement.cameras
        honest = replace(measurement, cov=cov, cameras=cameras)
        return skew.widened(honest, self._rig, not isinstance(self._target, Sphere))

    def _see(self, t_ns: int, pair: Pair, box: Box, guess: Prior | None) -> Found:
        """Stereo where the target is predicted, and the outline where stereo says: elsewhere it finds other edges.

        Without a prediction the outline first, and stereo there. Each helps the other where it fails.
        """
        if guess is None:
            size = self._trace(t_ns, pair, box, None)
            if isinstance(size, Measurement):
                guess = Prior(size.z, range_with_sigma(self._target, size.z, size.cov)[1])
            stereo = self._stereo.measure(t_ns, pair, box, guess)
            if not _same_place(size, stereo):
                size = self._outline_at(t_ns, pair, stereo, size)
        else:
            stereo = self._stereo.measure(t_ns, pair, box, guess)
            size = self._outline_at(t_ns, pair, stereo, None)
            if not isinstance(size, Measurement):
                size = self._trace(t_ns, pair, box, guess) or size
            if isinstance(stereo, Rejected) and not isinstance(size, Measurement):
                stereo = self._stereo.measure(t_ns, pair, box, None)
                size = self._outline_at(t_ns, pair, stereo, size)
        if size is None or self._outline is None:
            return [stereo]
        return [size, stereo, *self._outline.doubted(pair, size)]

    def _outline_at(self, t_ns: int, pair: Pair, stereo: Measurement | Rejected, size: Size) -> Size:
        """A ball's outline where stereo has it; the one found before (``size``), where it has none."""
        if self._outline is None or isinstance(stereo, Rejected):
            return size
        there = self._outline.measure(t_ns, pair, stereo.z)
        return there if isinstance(there, Measurement) or not isinstance(size, Measurement) else size

    def _trace(self, t_ns: int, pair: Pair, box: Box, guess: Prior | None) -> Size:
        """The ball's outline from the prediction, else from its box; None for what has none or before it has a size."""
        if self._outline is None:
            return None
        if guess is not None:
            size = self._outline.measure(t_ns, pair, guess.x)
            if isinstance(size, Measurement):
                return size
        if len(self._target.shape_mean):
            return None
        return self._outline.measure(t_ns, pair, self._idea(box))

    def _idea(self, box: Box) -> Array:
        """Where the target may be by its box alone: along its middle."""
        x, y, width, height = box
        middle = np.array([[x + width / 2, y + height / 2]])
        origins, directions = self._rig.rays(middle, "left")
        return np.concatenate([origins[0] + self._box_range(box) * directions[0], self._target.shape_mean])

    def _box_range(self, box: Box) -> float:
        """From a known ball's size in the image, else the last laser reading, else arm's length and some."""
        x, y, width, height = box
        if isinstance(self._target, Sphere) and self._target.diameter_m is not None:
            sides = self._rig.rays(np.array([[x, y + height / 2], [x + width, y + height / 2]]), "left")[1]
            angle = float(np.arccos(np.clip(sides[0] @ sides[1], -1, 1))) / 2
            return float(self._target.diameter_m / 2 / max(np.sin(angle), FAR_SINE))
        return (self._laser.last_length_m() if self._laser is not None else None) or 1.0


def _same_place(size: Size, stereo: Measurement | Rejected) -> bool:
    if not (isinstance(size, Measurement) and isinstance(stereo, Measurement)):
        return False
    return chi_square(size.z[:3] - stereo.z[:3], size.cov[:3, :3] + stereo.cov[:3, :3]) < APART
