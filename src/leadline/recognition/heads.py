"""The output layouts of the detectors in use, told apart by shape, class names and values, and decoded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Decoded = tuple[Floats, Floats, NDArray[np.int64]]  # boxes (N, 4) x0 y0 x1 y1 in input pixels, scores, classes (N,)

STRIDES = (8, 16, 32)
MOST_END_TO_END = 1000
EPS = 1e-3


@dataclass(frozen=True, slots=True)
class Head:
    """``decode(output without its batch axis, input width, input height, least score)``.

    ``bgr_255``: the input is BGR in 0..255.
    """

    name: str
    decode: Callable[[Floats, int, int, float], Decoded]
    bgr_255: bool = False


def recognise(output: Floats, width: int, height: int, classes: int = 0) -> Head | None:
    """The head that gave ``output`` for a grey image of ``width`` x ``height``, or None.

    ``classes``: how many the model says it knows, 0 where it does not say. Shapes alone do not tell: 80 classes on a
    64 x 64 input give 84 x 84, and a YOLOX of one class has six columns like an end-to-end model; scores are in 0..1
    and classes whole numbers only where they are meant to be.
    """
    if output.ndim != 3 or output.shape[0] != 1:
        return None
    table, cells = output[0], _cell_count(width, height)
    rows, columns = table.shape
    if columns >= 6 and rows == cells and classes in (0, columns - 5) and _in_unit(table[:, 4:]):
        return Head("yolox", decode_yolox_decoded if _is_decoded(table, width, height) else decode_yolox, bgr_255=True)
    if columns == 6 and rows <= MOST_END_TO_END and _in_unit(table[:, 4]) and _whole(table[:, 5]):
        return Head("end-to-end", decode_end_to_end)
    sized = columns == cells or rows < columns
    if rows >= 5 and sized and classes in (0, rows - 4) and _in_unit(table[4:]):
        return Head("yolov8", decode_yolov8)
    return None


def decode_yolov8(output: Floats, width: int, height: int, least: float) -> Decoded:
    """(4 + classes, N): centre x, centre y, width, height, then a score a class. leadline's own models too."""
    kept = output[:, output[4:].max(axis=0, initial=0.0) >= least].T
    return _best_class(_corners(kept[:, :4]), kept[:, 4:])


def decode_end_to_end(output: Floats, width: int, height: int, least: float) -> Decoded:
    """(N, 6): x0, y0, x1, y1, score, class."""
    kept = output[output[:, 4] >= least]
    return kept[:, :4], kept[:, 4], kept[:, 5].astype(np.int64)


def decode_yolox(output: Floats, width: int, height: int, least: float) -> Decoded:
    """(N, 5 + classes): offsets in cells and logarithmic sizes, objectness, scores (arXiv:2107.08430)."""
    keep = output[:, 4] >= least  # no score is above the objectness
    kept = output[keep]
    corner, stride_px = (part[keep] for part in _cells(width, height))
    centre = corner + kept[:, :2] * stride_px
    size = np.exp(np.minimum(kept[:, 2:4], 20)) * stride_px
    return _best_class(_corners(np.hstack([centre, size])), kept[:, 4:5] * kept[:, 5:])


def decode_yolox_decoded(output: Floats, width: int, height: int, least: float) -> Decoded:
    """The same, centre and size already in pixels, as LibreYOLO exports it."""
    kept = output[output[:, 4] >= least]
    return _best_class(_corners(kept[:, :4]), kept[:, 4:5] * kept[:, 5:])


def _cell_count(width: int, height: int) -> int:
    return sum((width // stride) * (height // stride) for stride in STRIDES)


@lru_cache(maxsize=8)
def _cells(width: int, height: int) -> tuple[Floats, Floats]:
    """First corners (N, 2) and strides (N, 1) of all cells, px, row by row, the smallest stride first."""
    corners, strides = [], []
    for stride in STRIDES:
        y, x = np.mgrid[0 : height // stride, 0 : width // stride]
        corners.append(stride * np.stack([x.ravel(), y.ravel()], 1))
        strides.append(np.full((x.size, 1), stride))
    return np.concatenate(corners).astype(np.float32), np.concatenate(strides).astype(np.float32)


def _is_decoded(table: Floats, width: int, height: int) -> bool:
    """Whether centres are nearer to their cells than to the image's corner: offsets in cells are all near that."""
    corner, stride_px = _cells(width, height)
    return bool(np.abs(table[:, :2] - corner - stride_px / 2).sum() < np.abs(table[:, :2]).sum())


def _in_unit(values: Floats) -> bool:
    return bool(((values >= -EPS) & (values <= 1 + EPS)).all())


def _whole(values: Floats) -> bool:
    return bool((values == np.round(values)).all())


def _corners(boxes: Floats) -> Floats:
    """Centre and size (N, 4) -> x0 y0 x1 y1."""
    return np.hstack([boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2])


def _best_class(boxes: Floats, scores: Floats) -> Decoded:
    classes = scores.argmax(1)
    return boxes, scores[np.arange(len(scores)), classes], classes.astype(np.int64)
