"""Pixels of ROS 2 image messages, and readings of range messages."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from leadline.samples import Image
from leadline.wire.images import decode_image

# encoding -> channels, and how they become grey or BGR (None: they are)
_ENCODINGS: dict[str, tuple[int, int | None]] = {
    "mono8": (1, None),
    "8uc1": (1, None),
    "bgr8": (3, None),
    "8uc3": (3, None),
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2BGR),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2BGR),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2BGR),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2BGR),
}


def pixels(message: Any) -> tuple[Image, bytes | None]:
    """Of a CompressedImage or an Image: (H, W, 3) BGR or (H, W), and the compressed bytes where there are any.

    Raises ValueError with one clear line.
    """
    if hasattr(message, "format"):
        data = bytes(message.data)
        return decode_image(data), data
    return _raw(message), None


def _raw(message: Any) -> Image:
    encoding, height, width, step = str(message.encoding).lower(), message.height, message.width, message.step
    if encoding not in _ENCODINGS:
        raise ValueError(f"the encoding {message.encoding!r} is not one of {', '.join(_ENCODINGS)}")
    channels, conversion = _ENCODINGS[encoding]
    data = np.frombuffer(message.data, np.uint8)
    if not height or step < width * channels or data.size != height * step:
        raise ValueError(f"{data.size} bytes are not {height} rows of {width} pixels of {encoding}")
    rows = data.reshape(height, step)[:, : width * channels]
    image = rows.reshape(height, width, channels) if channels > 1 else rows
    if conversion is not None:
        return np.asarray(cv2.cvtColor(np.ascontiguousarray(image), conversion), np.uint8)
    return np.ascontiguousarray(image)


def range_m(message: Any) -> float:
    """The reading, m: the shortest decimal that is this float32, which is what a device of up to seven digits said.

    Raises ValueError for what is outside the sensor's own limits: no echo, too near, too far.
    """
    value = float(str(np.float32(message.range)))
    nearest, farthest = float(message.min_range), float(message.max_range)
    if not 0 < value < float("inf") or (farthest > nearest and not nearest <= value <= farthest):
        raise ValueError(f"range {value:g} is not a distance between {nearest:g} and {farthest:g} m")
    return value
