"""The beam's image in one camera, as a table: pixel against inverse length, made once for a rig.

Over 1 / length a beam's image runs almost evenly (exactly so for a pinhole), so that a cubic through exact pixels and
exact slopes is as good as the projection itself and a hundred times cheaper.
"""

from __future__ import annotations

import numpy as np

from leadline.rig import Rig, Side
from leadline.rig_derivatives import SIDES, by_parameters, medium_of, project
from leadline.samples import Array

NODES = 256
_SPARSE = 24  # nodes of the calibration's errors
_LASER = tuple(f"laser.{key}[{i}]" for key in ("origin_m", "direction") for i in range(3))


class BeamImage:
    """Of a rig with a laser, between two lengths (m)."""

    def __init__(self, rig: Rig, side: Side, nearest_m: float, farthest_m: float) -> None:
        assert rig.laser is not None
        self.direction = rig.laser.direction
        self.across = _across(self.direction)  # (2, 3)
        self._first, self._step = 1 / farthest_m, (1 / nearest_m - 1 / farthest_m) / (NODES - 1)
        lengths = 1 / (self._first + self._step * np.arange(NODES))
        points = rig.laser.origin_m + lengths[:, None] * self.direction
        axis = np.array([0.0, 0.0, 1.0]) if side == "left" else rig.T_right_left.R[2]
        self.deeper: list[float] = [
            *(self.across @ axis).tolist(),
            float(axis @ self.direction),
        ]  # a metre, across (2), along
        self._start_m = float(axis @ (rig.laser.origin_m - (0 if side == "left" else rig.T_left_right.t_m)))
        q_px, jacobian = rig.project_with_jacobian(points, camera=side)
        slope_px = -(jacobian @ self.direction) * (lengths**2 * self._step)[:, None]  # per node
        rise, bend = np.diff(q_px, axis=0), slope_px[:-1] + slope_px[1:]
        parts = q_px[:-1], slope_px[:-1], 3 * rise - slope_px[:-1] - bend, bend - 2 * rise
        self._cubic = np.stack(parts, axis=1)  # (NODES - 1, 4, 2) px: Hermite's, of the part of a node
        self._plain = self._cubic.tolist()  # for one place at a time, which is most of the time
        self._u_px, self._v_px = q_px.T.copy()
        self._across_px = ((jacobian @ self.across.T) * lengths[:, None, None]).tolist()  # px m/m: almost constant

    def at(self, lengths_m: Array) -> Array:
        """Pixels (K, 2) of lengths (K,) within the table, by Hermite's cubic; NaN where unseen."""
        place = np.minimum(np.maximum((1 / lengths_m - self._first) / self._step, 0), NODES - 1 - 1e-9)
        node = place.astype(np.intp)
        t = (place - node)[:, None]
        cubic = self._cubic[node]
        return np.asarray(cubic[:, 0] + t * (cubic[:, 1] + t * (cubic[:, 2] + t * cubic[:, 3])))

    def depth_m(self, length_m: float) -> float:
        """Along the camera's axis."""
        return self._start_m + length_m * self.deeper[2]

    def closest(self, q_px: Array) -> float:
        """The length (m) whose pixel is nearest to q (2,), to about a node; NaN where the beam is nowhere seen."""
        u, v = q_px.tolist()
        off = (self._u_px - u) ** 2 + (self._v_px - v) ** 2
        off[np.isnan(off)] = np.inf
        nearest = int(off.argmin())
        return 1 / (self._first + self._step * nearest) if off[nearest] < np.inf else float("nan")

    def near(self, length_m: float) -> tuple[float, float, float, float]:
        """Pixel u, v and d(pixel)/d(length), px/m, at one length."""
        place = min(max((1 / length_m - self._first) / self._step, 0.0), NODES - 1 - 1e-9)
        node = int(place)
        t = place - node
        (u0, v0), (u1, v1), (u2, v2), (u3, v3) = self._plain[node]
        per_m = -1 / (self._step * length_m**2)
        return (
            u0 + t * (u1 + t * (u2 + t * u3)),
            v0 + t * (v1 + t * (v2 + t * v3)),
            per_m * (u1 + t * (2 * u2 + 3 * t * u3)),
            per_m * (v1 + t * (2 * v2 + 3 * t * v3)),
        )

    def sideways(self, length_m: float) -> tuple[tuple[float, float], tuple[float, float]]:
        """d(pixel)/d(offset across the beam), px/m: of u, of v."""
        place = min(max((1 / length_m - self._first) / self._step, 0.0), NODES - 1)
        (a, b), (c, d) = self._across_px[round(place)]
        return (a / length_m, b / length_m), (c / length_m, d / length_m)


class CalibrationPixels:
    """How far the rig's uncertainty moves the beam's image, both cameras together, over 1 / length."""

    def __init__(self, rig: Rig, nearest_m: float, farthest_m: float) -> None:
        assert rig.laser is not None
        names = tuple(n for n in rig.covariance.names if n.partition(".")[0] != "laser" or n in _LASER)
        self._inverse = np.linspace(1 / farthest_m, 1 / nearest_m, _SPARSE)
        lengths = 1 / self._inverse
        points = rig.laser.origin_m + lengths[:, None] * rig.laser.direction
        turns = np.eye(3) - np.outer(rig.laser.direction, rig.laser.direction)  # its length stays 1
        changed = np.zeros((_SPARSE, 4, len(names)))
        for i, side in enumerate(SIDES if names else ()):
            medium = medium_of(rig)
            pixels, by_point = project(rig, side, medium, points)
            part = by_parameters(rig, side, medium, points, pixels, by_point, names)
            for column, name in enumerate(names):
                if name in _LASER:
                    axis = int(name[-2])
                    turned = by_point @ turns * lengths[:, None, None]
                    part[:, :, column] = (by_point if "origin" in name else turned)[:, :, axis]
            changed[:, 2 * i : 2 * i + 2] = part
        self.exact = not names
        self._cov_px2 = np.nan_to_num(changed @ rig.covariance.of(names) @ changed.transpose(0, 2, 1))

    def at(self, length_m: float) -> Array:
        """(4, 4) px^2: of left u, v and right u, v."""
        place = float(np.interp(1 / length_m, self._inverse, np.arange(_SPARSE)))
        node = min(int(place), _SPARSE - 2)
        part = place - node
        return np.asarray((1 - part) * self._cov_px2[node] + part * self._cov_px2[node + 1])


def _across(direction: Array) -> Array:
    """Two unit vectors across a direction, as rows (2, 3)."""
    first = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first)])
