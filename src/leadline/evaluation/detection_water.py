"""How much of a picture the water leaves: its local contrast.

Standard deviation over mean of the grey levels within a window (Gaussian, sigma 8 px of a picture scaled to 320 px),
of which the 90th percentile is taken: where there is something to see. Veiling light and blur both lower it; haze that
leaves a part t of the scene's light lowers it to t. On the rendered approaches it stays within 0.09 to 0.11 in clear
water from 2.2 to 0.2 m and goes from 0.01 to 0.07 in turbid water; UCIQE (Yang and Sowmya 2015), the index often used,
goes there from 0.18 to 0.27 and from 0.13 to 0.21: it tells the target's colour as much as the water.

It speaks of the picture, not of the water alone: an empty wall has little contrast in the clearest water.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from leadline.samples import Array, Image

LONG_SIDE_PX = 320
WINDOW_SIGMA_PX = 8.0
PERCENTILE = 90
BLACK = 5.0  # grey levels: noise in the dark is no contrast
FEWEST = 6  # images, to be told apart by thirds


def local_contrast(image: Image) -> float:
    """Of a picture (H, W, 3) BGR or (H, W); 0 where it is of one grey."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    scale = LONG_SIDE_PX / max(grey.shape)
    size = (max(round(grey.shape[1] * scale), 1), max(round(grey.shape[0] * scale), 1))
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA).astype(np.float64)
    mean = cv2.GaussianBlur(small, (0, 0), WINDOW_SIGMA_PX)
    square = cv2.GaussianBlur(small**2, (0, 0), WINDOW_SIGMA_PX)
    deviation = np.sqrt(np.maximum(square - mean**2, 0))
    return float(np.percentile(deviation / (mean + BLACK), PERCENTILE))


def thirds(contrast: Array) -> tuple[list[str], NDArray[np.int64]]:
    """Names of the groups that pictures (N,) fall into by their contrast, lowest first, and each one's number (N,).

    Thirds of the set itself, so that each holds pictures enough; a handful of them, or all alike, stay together.
    """
    edges = np.quantile(contrast, (1 / 3, 2 / 3)) if len(contrast) >= FEWEST else np.zeros(2)
    if edges[1] <= edges[0]:
        return ["all"], np.zeros(len(contrast), np.int64)
    low, high = (f"{edge:.2g}" for edge in edges)
    names = [f"murky (below {low})", f"middle ({low} to {high})", f"clear (above {high})"]
    return names, np.searchsorted(edges, contrast).astype(np.int64)
