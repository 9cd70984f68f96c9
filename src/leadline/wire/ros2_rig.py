"""A rig from the CameraInfo messages of a stereo pair."""

from __future__ import annotations

from typing import Any

import numpy as np

from leadline.errors import InputError
from leadline.geometry import Camera, Pose
from leadline.rig import Rig

_MODELS = ("plumb_bob", "rational_polynomial")
_FIX = "calibrate the pair with camera_calibration, or give a rig"


def rig_from_camera_infos(left: Any, right: Any) -> Rig:
    """A pair of pinholes, without port and laser. InputError where the pair is not calibrated."""
    where = f"CameraInfo of {left.header.frame_id or 'left'} and {right.header.frame_id or 'right'}"
    if left.p[0] <= 0 or right.p[0] <= 0 or right.p[3] == 0:
        raise InputError("the pair is not calibrated: P of the right camera has no baseline", where, _FIX)
    left_R, right_R = (np.array(info.r, float).reshape(3, 3) for info in (left, right))
    shift_m = np.array([right.p[3] / right.p[0], 0.0, 0.0])
    try:
        return Rig(_camera(left, where), _camera(right, where), Pose(right_R.T @ left_R, right_R.T @ shift_m))
    except ValueError as error:
        raise InputError(str(error), where, _FIX) from error


def _camera(info: Any, where: str) -> Camera:
    if info.distortion_model not in _MODELS:
        raise InputError(f"distortion_model: {info.distortion_model!r} is not known", where, _FIX)
    fx, _, cx, _, fy, cy, *_ = (float(number) for number in info.k)
    return Camera(fx, fy, cx, cy, int(info.width), int(info.height), tuple(float(number) for number in info.d))
