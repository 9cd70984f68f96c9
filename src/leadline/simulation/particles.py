"""Marine snow: particles that hang in the scene, seen by both cameras where they truly are."""

from __future__ import annotations

import numpy as np

from leadline.geometry import Pose
from leadline.rig import Rig
from leadline.samples import Array
from leadline.simulation.optics import Float

_BOX_M = np.array([2.6, 1.8, 2.4])  # repeats in all directions; the camera always looks into the box before it
_BURST_S = 0.6
_BURST_FACTOR = 5.0


class Snow:
    def __init__(self, per_m3: float, bursts_s: tuple[float, ...], rng: np.random.Generator) -> None:
        self._usual = min(round(per_m3 * float(np.prod(_BOX_M))), 20000)
        count = round(self._usual * (1 + _BURST_FACTOR)) if bursts_s else self._usual
        self._bursts_s = bursts_s
        self._places_m = rng.uniform(0, 1, (count, 3)) * _BOX_M
        self._drift_m_s = rng.normal([0.01, 0.012, 0.0], 0.008, (count, 3))
        self.radius_m = np.exp(rng.normal(np.log(3.5e-4), 0.45, count))

    def seen(self, t_s: float, T_left_scene: Pose) -> tuple[Array, Array]:
        """Places (N, 3), left frame, m, of what hangs before the cameras, and radii (N,), m."""
        burst = sum(float(np.exp(-(((t_s - at) / _BURST_S) ** 2))) for at in self._bursts_s)
        count = min(round(self._usual * (1 + _BURST_FACTOR * burst)), len(self._places_m))
        ahead = T_left_scene.inverse().apply(np.array([0.0, 0.0, _BOX_M[2] / 2]))
        moved = self._places_m[:count] + self._drift_m_s[:count] * t_s - ahead
        places = T_left_scene.apply((moved + _BOX_M / 2) % _BOX_M - _BOX_M / 2 + ahead)
        z = places[:, 2]
        seen = (z > 0.06) & (np.abs(places[:, 0]) < 0.9 * z + 0.1) & (np.abs(places[:, 1]) < 0.6 * z + 0.1)
        return places[seen], self.radius_m[:count][seen]


def project_side(rig: Rig, side: str, places_m: Array) -> Array:
    """Pixels (N, 2) of one camera."""
    return rig.project(places_m)[0 if side == "left" else 1]


def splat(image: Float, pixels: Array, sigma_px: Array, peak: Float) -> None:
    """Add Gaussian blobs of peak (N, 3) to an image (h, w, 3) in place."""
    height, width = image.shape[:2]
    flat = image.reshape(-1, 3)
    window = np.ceil(2.6 * sigma_px + 0.5).astype(int)
    for reach in np.unique(np.minimum(window, 24)):
        mine = np.minimum(window, 24) == reach
        centre = np.round(pixels[mine]).astype(int)
        steps = np.arange(-reach, reach + 1)
        x, y = centre[:, 0, None] + steps, centre[:, 1, None] + steps
        s = sigma_px[mine, None]
        gx = np.exp(-0.5 * ((x - pixels[mine, 0, None]) / s) ** 2) * ((x >= 0) & (x < width))
        gy = np.exp(-0.5 * ((y - pixels[mine, 1, None]) / s) ** 2) * ((y >= 0) & (y < height))
        weight = (gy[:, :, None] * gx[:, None, :]).astype(np.float32)
        index = np.clip(y, 0, height - 1)[:, :, None] * width + np.clip(x, 0, width - 1)[:, None, :]
        light = weight[..., None] * peak[mine][:, None, None, :]
        np.add.at(flat, index.reshape(-1), light.reshape(-1, 3))
