"""How the camera turns, where a gyroscope tells: its mean rotation between two times."""

from __future__ import annotations

from bisect import bisect_right, insort

import numpy as np

from leadline.samples import NS_PER_S, Array, VehicleMotion

HOLD_NS = NS_PER_S // 5  # a rotation counts for so long about its stamp


class Turns:
    """Rotations of the last ``horizon_s`` before the newest."""

    def __init__(self, horizon_s: float) -> None:
        self._horizon_ns = int(horizon_s * NS_PER_S)
        self._known: list[tuple[int, tuple[float, float, float], float]] = []

    def add(self, motion: VehicleMotion) -> None:
        if motion.rotation_rad_s is None:
            return
        insort(self._known, (motion.t_ns, motion.rotation_rad_s, motion.rotation_sigma_rad_s))
        del self._known[: max(self._place(self._known[-1][0] - self._horizon_ns) - 1, 0)]

    def mean(self, from_ns: int, to_ns: int) -> tuple[Array | None, float]:
        """The rotation (3,) and its sigma in rad/s: the mean of what was told between, else the nearest; or None."""
        if not self._known:
            return None, 0.0
        first, last = self._place(from_ns), self._place(to_ns)
        told = self._known[first:last]
        if not told:
            told = [t for t in self._known[max(first - 1, 0) : first + 1] if self._near(t[0], from_ns, to_ns)][:1]
        if not told:
            return None, 0.0
        x, y, z = (sum(axis) / len(told) for axis in zip(*(rotation for _, rotation, _ in told), strict=True))
        return np.array((x, y, z)), told[-1][2]

    def _near(self, t_ns: int, from_ns: int, to_ns: int) -> bool:
        return from_ns - HOLD_NS <= t_ns <= to_ns + HOLD_NS

    def _place(self, t_ns: int) -> int:
        return bisect_right(self._known, t_ns, key=lambda told: told[0])
