"""A board that is not flat: what a calibration makes of it, and how its residuals betray it where it is taken for flat.

A bow of 0.1 mm is enough to make a calibration wrong by ten of its stated sigmas, and costs nothing to estimate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from leadline.calibration.cameras import WARP_PRIOR, CameraCalibration
from leadline.calibration.problem import WARP_NAMES, Problem
from leadline.samples import Array

_SURE = 30.0  # chi2 of two degrees of freedom: once in three million for a flat board
_MATTERS_M = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Warp:
    """How far a board's middle stands out (2,), m, bent along its rows and its columns; its covariance (2, 2).

    moves: how far a calibration that took the board for flat is off by that, in its own sigmas (the parameter that is
    off most); 0 where the warp was estimated.
    """

    warp_m: Array
    cov_m2: Array
    moves: float = 0.0

    @property
    def sure(self) -> bool:
        """The board is bent, beyond its noise and by enough to matter."""
        chi2 = float(self.warp_m @ np.linalg.solve(self.cov_m2, self.warp_m))
        return chi2 > _SURE and float(np.abs(self.warp_m).max()) > _MATTERS_M

    def __str__(self) -> str:
        sigma = np.sqrt(np.diag(self.cov_m2))
        rows, columns = (f"{1e3 * w:+.3f} +-{1e3 * s:.3f} mm" for w, s in zip(self.warp_m, sigma, strict=True))
        return f"{rows} along its rows, {columns} along its columns"


def warp_of(calibration: CameraCalibration) -> Warp:
    """As estimated with the rest; where the board was taken for flat, what one step of a fit that lets it bend says."""
    fit = calibration.fit
    if fit.names[-2:] == WARP_NAMES:
        return Warp(fit.warp_m, fit.covariance[-2:, -2:])
    priors = calibration.priors | dict.fromkeys(WARP_NAMES, WARP_PRIOR)
    wider = Problem(calibration.problem.sights, (*fit.names, *WARP_NAMES), priors)
    step, covariance = wider.first_step(fit.rig, fit.poses, fit.sigma_px)
    moves = float(np.max(np.abs(step[:-2]) / np.sqrt(np.diag(fit.covariance))))
    return Warp(step[-2:], covariance[-2:, -2:], moves)
