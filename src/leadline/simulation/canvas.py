"""What a training picture is painted on before water and camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from leadline.simulation.optics import Float

Box = tuple[float, float, float, float]  # x, y, w, h in pixels, (0, 0) the outer corner of the first one


@dataclass(slots=True)
class Canvas:
    """The scene as the camera sees it in air: reflectance (h, w, 3), distance (h, w), shading (h, w), owner (h, w)."""

    reflectance: Float
    distance_m: Float
    shading: Float
    owner: NDArray[np.int16]  # -1 background and clutter, else the ball's number

    def paint(self, at: tuple[slice, slice], colour: Float, alpha: Float, distance_m: Float, shading: Float) -> None:
        """Lay a patch over the canvas."""
        a = alpha[..., None]
        self.reflectance[at] += (colour - self.reflectance[at]) * a
        self.distance_m[at] += (distance_m - self.distance_m[at]) * alpha
        self.shading[at] += (shading - self.shading[at]) * alpha
