"""The output layouts of the detectors in use, told apart by shape, each decoded to boxes, scores and classes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Decoded = tuple[
    Floats, Floats, NDArray[np.int64]
]  # boxes (N, 4) x0 y0 x1 y1 in input pixels, scores (N,), classes (N,)

YOLOX_STRIDES = (8, 16, 32)


@dataclass(frozen=True, slots=True)
class Head:
    """``decode(output without its batch axis, input width, input height)``; ``bgr_255``: the input is BGR in 0..255."""

    name: str
    decode: Callable[[Floats, int, int], Decoded]
    bgr_255: bool = False


def recognise(shape: tuple[int, ...], width: int, height: int) -> Head | None:
    """The head whose output on a ``width`` x ``height`` input has this shape, or None."""
    if len(shape) != 3 or shape[0] != 1:
        return None
    _, rows, columns = shape
    if columns >= 6 and rows == sum((width // s) * (height // s) for s in YOLOX_STRIDES):
        return Head("yolox", decode_yolox, bgr_255=True)
    if columns == 6 and rows <= 1000:
        return Head("end-to-end", decode_end_to_end)
    if 5 <= rows < columns:
        return Head("yolov8", decode_yolov8)
    return None


def decode_yolov8(output: Floats, width: int, height: int) -> Decoded:
    """(4 + classes, N): centre x, centre y, width, height, then a score a class. leadline's own models too."""
    return _best_class(_corners(output[:4].T), output[4:].T)


def decode_end_to_end(output: Floats, width: int, height: int) -> Decoded:
    """(N, 6): x0, y0, x1, y1, score, class."""
    return output[:, :4], output[:, 4], output[:, 5].astype(np.int64)


def decode_yolox(output: Floats, width: int, height: int) -> Decoded:
    """(N, 5 + classes): offsets in cells and logarithmic sizes, objectness, scores (arXiv:2107.08430)."""
    cells, strides = [], []
    for stride in YOLOX_STRIDES:
        y, x = np.mgrid[0 : height // stride, 0 : width // stride]
        cells.append(np.stack([x.ravel(), y.ravel()], 1))
        strides.append(np.full((x.size, 1), stride))
    cell, stride_px = np.concatenate(cells), np.concatenate(strides)
    centre = (output[:, :2] + cell) * stride_px
    size = np.exp(np.minimum(output[:, 2:4], 20)) * stride_px
    return _best_class(_corners(np.hstack([centre, size]).astype(np.float32)), output[:, 4:5] * output[:, 5:])


def _corners(boxes: Floats) -> Floats:
    """Centre and size (N, 4) -> x0 y0 x1 y1."""
    return np.hstack([boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2])


def _best_class(boxes: Floats, scores: Floats) -> Decoded:
    classes = scores.argmax(1)
    return boxes, scores[np.arange(len(scores)), classes], classes.astype(np.int64)
