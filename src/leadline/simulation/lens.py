"""Blur of a lens out of focus, of water, and of motion during the exposure."""

from __future__ import annotations

import cv2
import numpy as np

from leadline.samples import Array
from leadline.simulation.optics import Float, f32


def smear(image: Float, sigma_px: float, motion_px: Array) -> Float:
    """Gaussian blur, and a uniform motion by ``motion_px`` (x, y); both as one Gaussian of the same second moments."""
    length = float(np.hypot(*motion_px))
    if length < 0.25:
        return f32(cv2.GaussianBlur(image, (0, 0), sigma_px, borderType=cv2.BORDER_REFLECT_101))
    along = motion_px / length
    cov = sigma_px**2 * np.eye(2) + (min(length, 20.0) ** 2 / 12) * np.outer(along, along)
    reach = int(np.ceil(3 * np.sqrt(np.trace(cov))))
    x, y = np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1))
    places = np.stack([x, y], -1)
    kernel = np.exp(-0.5 * np.einsum("...i,ij,...j", places, np.linalg.inv(cov), places))
    return f32(cv2.filter2D(image, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REFLECT_101))
