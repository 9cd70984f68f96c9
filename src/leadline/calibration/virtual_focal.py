"""The paper's virtual focal length in water, equations 11-12: f'_x = (Z / X)(u - c_x), averaged over the distances."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from leadline.calibration.spots import Station
from leadline.paper.pinhole_pair import LEAST_OFFSET_M, PinholePair
from leadline.rig import Rig
from leadline.samples import Array


@dataclass(frozen=True, slots=True, eq=False)
class VirtualFocal:
    """f' by station: distances Z (N,), f'_x and f'_y (N,), px, NaN where the spot is on that axis."""

    z_m: Array
    fx_each_px: Array
    fy_each_px: Array

    @property
    def fx_px(self) -> float:
        return float(np.nanmean(self.fx_each_px))

    @property
    def fy_px(self) -> float:
        return float(np.nanmean(self.fy_each_px))

    @property
    def scatter_px(self) -> tuple[float, float]:
        """Standard deviations over the stations: what one number for all distances leaves."""
        return float(np.nanstd(self.fx_each_px)), float(np.nanstd(self.fy_each_px))


def virtual_focal(rig: Rig, stations: Sequence[Station]) -> VirtualFocal | None:
    """f' from the laser points of the readings (eq. 14) and the left pixels of their spots, rectified as in
    ``leadline.paper``; None where no station is off both axes, or the rig has no laser."""
    if rig.laser is None:
        return None
    pair = PinholePair(dataclasses.replace(rig, virtual_focal_px=(1.0, 1.0)))  # its own f' is not asked for
    points = np.array([rig.laser.point_m(s.raw_m) for s in stations]) @ pair.R_rectified_left.T
    pixels = np.array([pair.rectified_px(s.left.q_px) for s in stations]) - [pair.cx_px, pair.cy_px]
    with np.errstate(divide="ignore", invalid="ignore"):
        each = points[:, 2:] / points[:, :2] * pixels
    each[np.abs(points[:, :2]) < LEAST_OFFSET_M] = np.nan
    if not np.isfinite(each).any(axis=0).all():
        return None
    return VirtualFocal(points[:, 2], each[:, 0], each[:, 1])
