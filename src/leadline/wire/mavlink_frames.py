"""MAVLink's frames and ours: its body is forward-right-down (FRD), ours REP-103 (forward, port, up); its earth NED."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from leadline.geometry.pose import Pose
from leadline.samples import NS_PER_S, Array

FLIP = np.array([1.0, -1.0, -1.0])  # between forward-port-up and forward-right-down, either way
ORIENTATIONS = {  # MAV_SENSOR_ORIENTATION of a distance sensor that looks this way (FRD)
    0: (1, 0, 0),
    2: (0, 1, 0),
    4: (-1, 0, 0),
    6: (0, -1, 0),
    24: (0, 0, -1),
    25: (0, 0, 1),
}


def frd(vector: ArrayLike) -> Array:
    """A vector (3,) of the body, REP-103 to FRD or back."""
    turned: Array = np.asarray(vector, dtype=np.float64) * FLIP
    return turned


def orientation(T_body_left: Pose) -> int:
    """Which of MAVLink's six directions the camera looks in, the nearest."""
    ahead = frd(T_body_left.rotate([0.0, 0.0, 1.0]))
    return max(ORIENTATIONS, key=lambda key: float(ahead @ np.array(ORIENTATIONS[key])))


def ned_to_frd(v_ned: ArrayLike, roll_rad: float, pitch_rad: float, yaw_rad: float) -> Array:
    """A velocity over ground in the body, by the attitude (yaw, then pitch, then roll)."""
    cr, sr, cp, sp, cy, sy = (f(angle) for angle in (roll_rad, pitch_rad, yaw_rad) for f in (np.cos, np.sin))
    R_ned_frd = np.array(
        [
            [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
            [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
            [-sp, sr * cp, cr * cp],
        ]
    )
    v_frd: Array = R_ned_frd.T @ np.asarray(v_ned, dtype=np.float64)
    return v_frd


def camera_motion(
    T_body_left: Pose, rotation_frd_rad_s: ArrayLike, velocity_frd_m_s: ArrayLike | None
) -> tuple[Array, Array | None]:
    """The left camera's rotation and velocity over ground in its own frame: a turning vehicle swings its camera."""
    rotation_body = frd(rotation_frd_rad_s)
    R_left_body = T_body_left.R.T
    if velocity_frd_m_s is None:
        return R_left_body @ rotation_body, None
    velocity_body = frd(velocity_frd_m_s) + np.cross(rotation_body, T_body_left.t_m)
    return R_left_body @ rotation_body, R_left_body @ velocity_body


class BootClock:
    """The autopilot counts from its own start: the quickest message so far says when that was.

    A later one is believed more with time (10 microseconds a second), as two clocks drift apart.
    """

    DRIFT = 1e-5

    def __init__(self) -> None:
        self._offset_ns: float | None = None
        self._last_ns = 0

    def stamp_ns(self, boot_ms: int, arrival_ns: int) -> int:
        """When a message was made, in our time. A restarted autopilot starts the count again."""
        offset_ns = float(arrival_ns - boot_ms * 1_000_000)
        if self._offset_ns is None or abs(offset_ns - self._offset_ns) > NS_PER_S:
            self._offset_ns = offset_ns
        self._offset_ns = min(offset_ns, self._offset_ns + self.DRIFT * max(arrival_ns - self._last_ns, 0))
        self._last_ns = arrival_ns
        return round(self._offset_ns) + boot_ms * 1_000_000
