"""Points that both images show: whatever texture a dive has says where left and right look, through the port.

A match has four pixel coordinates and three unknowns of its own, so one number is left: how far the two rays miss each
other. Spread over the field, that number shows the port's tilt and distance, which one beam hardly can.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from leadline.geometry import midpoints
from leadline.rig import Rig
from leadline.rig_derivatives import SIDES, by_parameters, medium_of, project
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
    """How far left and right rays miss each other (M,), signed, px: a miss has the noise of one pixel coordinate."""
    return _Meeting(rig, matches_px).misses


def misses_by_names(rig: Rig, matches_px: Array, names: Sequence[str]) -> Array:
    """-d(misses)/d(parameters) (M, k)."""
    return _Meeting(rig, matches_px).by_names(names)


class _Meeting:
    """Points (M, 3) where the rays of matches meet, and the one direction e (M, 4) of the four pixel coordinates in
    which no move of the point can take a residual away: e^T dq/dpoint = 0, |e| = 1."""

    def __init__(self, rig: Rig, matches_px: Array) -> None:
        self._rig, self._medium = rig, medium_of(rig)
        self._points = midpoints(*rig.rays(matches_px[:, :2], "left"), *rig.rays(matches_px[:, 2:], "right"))
        (left, A), (right, B) = (project(rig, side, self._medium, self._points) for side in SIDES)
        self._seen = ((left, A), (right, B))
        a, b = np.cross(A[:, 0], A[:, 1]), np.cross(B[:, 0], B[:, 1])  # along the rays
        columns = [(A[:, 1], b), (-A[:, 0], b), (B[:, 1], a), (-B[:, 0], a)]
        e = np.stack([np.einsum("mi,mi->m", row, ray) for row, ray in columns], axis=1)
        self._e = e / np.linalg.norm(e, axis=1)[:, None]
        self.misses: Array = np.einsum("mi,mi->m", self._e, matches_px - np.hstack([left, right]))

    def by_names(self, names: Sequence[str]) -> Array:
        parts = [
            by_parameters(self._rig, side, self._medium, self._points, pixels, jacobian, names)
            for side, (pixels, jacobian) in zip(SIDES, self._seen, strict=True)
        ]
        return np.asarray(np.einsum("mi,mik->mk", self._e, np.concatenate(parts, axis=1)))
