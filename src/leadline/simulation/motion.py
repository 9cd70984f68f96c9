"""The vehicle's way: smooth functions of time, so that its velocity is known as exactly as its place.

The scene's frame has its origin at the target and its axes along the left camera's when the vehicle does not sway.
"""

from __future__ import annotations

import numpy as np

from leadline.geometry import Pose
from leadline.samples import Array
from leadline.simulation.scenario import PathPart


class Motion:
    """``pose`` gives T_left_scene at any time. ``reach_m``: from the target's origin to its front."""

    def __init__(self, path: PathPart, reach_m: float, rng: np.random.Generator) -> None:
        self._path, self._reach_m = path, reach_m
        self._travel_s = (path.start_m - path.end_m) / path.speed_m_s
        # Three incommensurate waves per degree of freedom, the slow one the strongest: sway x, y, z; turn x, y, z.
        self._rate = 2 * np.pi / path.sway_s * np.array([1.0, 1.9, 3.1]) * rng.uniform(0.8, 1.2, (6, 3))
        self._phase = rng.uniform(0, 2 * np.pi, (6, 3))
        weight = np.array([0.6, 0.3, 0.1])
        amplitude = np.array([*path.sway_m, *([np.deg2rad(path.attitude_deg)] * 3)])
        self._amplitude = amplitude[:, None] * weight

    def distance_m(self, t_s: float) -> float:
        """From the camera to the target's front along z, without the sway."""
        path = self._path
        u = np.clip(t_s / self._travel_s, 0.0, 1.0) if self._travel_s > 0 else 1.0
        # The speed is 1 - 0.8 cos(2 pi u) of the mean: a soft start, a soft stop.
        done = u - 0.8 / (2 * np.pi) * np.sin(2 * np.pi * u)
        return float(path.start_m + (path.end_m - path.start_m) * done)

    def pose(self, t_s: float) -> Pose:
        """T_left_scene: p_left = R p_scene + t."""
        sway = (self._amplitude * np.sin(self._rate * t_s + self._phase)).sum(1)
        target_m = np.array([*self._path.offset_m, self.distance_m(t_s) + self._reach_m]) + sway[:3]
        R = rotation(sway[3:])
        return Pose(R, R @ target_m)

    def twist(self, t_s: float, step_s: float = 1e-4) -> tuple[Array, Array]:
        """The camera's v (3,), m/s, and w (3,), rad/s, in its own frame: what stands still at p moves by -v - w x p."""
        before, now, after = (self.pose(t_s + step) for step in (-step_s, 0.0, step_s))
        turn = -(after.R - before.R) @ now.R.T / (2 * step_s)  # the cross product with w, as a matrix
        w = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
        return -np.cross(w, now.t_m) - (after.t_m - before.t_m) / (2 * step_s), w


def rotation(vector: Array) -> Array:
    """The rotation (3, 3) about a vector by its length (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turned: Array = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * (K @ K)
    return turned
