"""Points that both images show: whatever texture a dive has says where left and right look, through the port.

A match has four pixel coordinates and three unknowns of its own, so one number is left: how far the two rays miss each
other. Spread over the field, that number shows the port's tilt and distance, which one beam hardly can.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from leadline.rig import Rig
from leadline.samples import Array, Image

Pixels = NDArray[np.float32]

COUNT = 80  # of each frame
_WINDOW_PX = 21
_BACK_PX = 0.15  # there and back again must end where it began


def find_matches(left: Image, right: Image, shift_px: Array) -> Array:
    """Corners of the left image and their places in the right one (M, 4), from a first guess of the shift (2,)."""
    a, b = (i if i.ndim == 2 else np.asarray(cv2.cvtColor(i, cv2.COLOR_BGR2GRAY), np.uint8) for i in (left, right))
    corners: Any = cv2.goodFeaturesToTrack(a, COUNT, 0.05, max(a.shape) // 60)
    if corners is None:
        return np.zeros((0, 4))
    start = np.asarray(corners, np.float32).reshape(-1, 1, 2)
    there, found = _followed(a, b, start, start + np.asarray(shift_px, np.float32))
    back, again = _followed(b, a, there, start)
    kept = found & again & (np.linalg.norm(back - start, axis=2).ravel() < _BACK_PX)
    return np.hstack([start[kept, 0], there[kept, 0]]).astype(np.float64)


def _followed(a: Image, b: Image, start: Pixels, guess: Pixels) -> tuple[Pixels, NDArray[np.bool_]]:
    there, status, _ = cv2.calcOpticalFlowPyrLK(
        a, b, start, guess.copy(), winSize=(_WINDOW_PX, _WINDOW_PX), maxLevel=1, flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 0.005),
    )  # fmt: skip
    return np.asarray(there, np.float32), np.asarray(status).ravel() == 1


def misses_px(rig: Rig, matches_px: Array) -> Array:
    """How far left and right rays miss each other (M,), signed, in pixels (of the root of two: both share it)."""
    origins_a, a = rig.rays(matches_px[:, :2], "left")
    origins_b, b = rig.rays(matches_px[:, 2:], "right")
    across = np.cross(a, b)
    norm = np.linalg.norm(across, axis=1)
    apart = origins_b - origins_a
    miss_m = np.einsum("ij,ij->i", apart, across) / norm
    along_m = np.abs(np.einsum("ij,ij->i", np.cross(apart, b), across)) / norm**2
    focal = rig.left.fx * (1.0 if rig.port is None else rig.port.outside_index)
    return np.asarray(miss_m / along_m * focal / np.sqrt(2))
