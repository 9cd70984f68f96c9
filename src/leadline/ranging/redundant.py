"""Three ways to one length, that of the beam, and which of them is off when the other two agree.

- *stereo*: the spot triangulated from both images; the laser's calibration has no part in it but its direction's.
- *beam*: where the spot lies along the beam's image, each camera alone; the baseline has no part in it.
- *laser*: the device's time of flight; no camera has.

A wrong water index or a bent camera bracket shows in stereo, a laser that was knocked in beam, a false return or a
wrong range correction in the laser.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from leadline.ranging.beam import BeamRanger, Seen
from leadline.rig import Rig
from leadline.samples import Array

AGREE_SIGMAS = 4.0
NAMES = ("stereo on the spot", "the beam's place in one image", "the laser's reading")


@dataclass(frozen=True, slots=True)
class ThreeRanges:
    """lengths_m (3,) of stereo, beam and laser, NaN where there is none; covariance (3, 3) of their noise."""

    lengths_m: Array
    cov_m2: Array

    @property
    def verdict(self) -> str:
        """Plain words on what is off; '' where all that there is agrees."""
        known = np.flatnonzero(np.isfinite(self.lengths_m))
        apart = {pair: self._apart(*pair) for pair in combinations(known.tolist(), 2)}
        far = {pair for pair, (_, sigmas) in apart.items() if abs(sigmas) > AGREE_SIGMAS}
        if not far:
            return ""
        near = set(apart) - far
        if len(known) == 3 and len(near) == 1:
            good = next(iter(near))
            odd = next(i for i in range(3) if i not in good)
            mean = float(self.lengths_m[list(good)].mean())
            off_mm = 1e3 * (float(self.lengths_m[odd]) - mean)
            agreed = " and ".join(NAMES[i] for i in good)
            return f"{NAMES[odd]} is off by {off_mm:+.1f} mm at {mean:.2f} m: {agreed} agree"
        a, b = max(far, key=lambda pair: abs(apart[pair][1]))
        sigmas = abs(apart[a, b][1])
        return f"{NAMES[a]} and {NAMES[b]} differ by {1e3 * apart[a, b][0]:+.1f} mm ({sigmas:.1f} sigma)"

    def _apart(self, i: int, j: int) -> tuple[float, float]:
        """Difference j - i (m), and in its sigmas."""
        difference = float(self.lengths_m[j] - self.lengths_m[i])
        variance = float(self.cov_m2[i, i] + self.cov_m2[j, j] - 2 * self.cov_m2[i, j])
        return difference, difference / max(variance, 1e-12) ** 0.5


def three_ranges(rig: Rig, ranger: BeamRanger, seen: Seen, raw_m: float | None = None) -> ThreeRanges | None:
    """From the spot in both images and a reading (raw, m) of the same moment; None where the spot was not seen twice.

    Differences of stereo and beam come from the same pixels: their common noise is in the covariance.
    """
    if rig.laser is None or set(seen) != {"left", "right"}:
        return None
    whole = _from_pixels(rig, ranger, seen)
    if whole is None:
        return None
    steps = np.eye(4) * 0.05
    pixels = np.concatenate([seen["left"][0], seen["right"][0]])
    cov_px2 = np.zeros((4, 4))
    cov_px2[:2, :2], cov_px2[2:, 2:] = seen["left"][1], seen["right"][1]
    moved = []
    for step in steps:
        q = pixels + step
        other = _from_pixels(rig, ranger, {"left": (q[:2], seen["left"][1]), "right": (q[2:], seen["right"][1])})
        moved.append(np.full(2, np.nan) if other is None else (other - whole) / 0.05)
    slope = np.array(moved).T
    cov = np.zeros((3, 3))
    cov[:2, :2] = slope @ cov_px2 @ slope.T
    cov[2, 2] = rig.laser.length_sigma_m**2 + ranger.calibration_variance_m2
    reading = np.nan if raw_m is None else rig.laser.length_m(raw_m)
    return ThreeRanges(np.array([*whole, reading]), cov)


def _from_pixels(rig: Rig, ranger: BeamRanger, seen: Seen) -> Array | None:
    """Lengths (2,) by stereo and by the beam's place, the mean of both cameras by their weights."""
    assert rig.laser is not None
    p_left_m, _ = rig.triangulate(seen["left"][0][None], seen["right"][0][None])
    alone = [ranger.solve({side: seen[side]}) for side in seen]
    if not np.isfinite(p_left_m).all() or any(one is None for one in alone):
        return None
    weights = [1 / one[1] for one in alone if one is not None]
    lengths = [one[0] for one in alone if one is not None]
    stereo = float((p_left_m[0] - rig.laser.origin_m) @ rig.laser.direction)
    return np.array([stereo, float(np.average(lengths, weights=weights))])
