"""How good a detector is: precision, recall and average precision as COCO counts them.

Boxes are x, y, w, h in one and the same pixel convention. One class: whoever needs several calls once for each. The
tests hold the figures against faster-coco-eval, to all digits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from leadline.samples import Array, Detection

IOUS = np.linspace(0.5, 0.95, 10)
RECALLS = np.linspace(0, 1, 101)
MOST_PER_IMAGE = 100

Box = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class DetectionQuality:
    """AP over IoU thresholds and the precision-recall curve at IoU 0.5.

    ``ap`` (10,) at IoU 0.50, 0.55 ... 0.95. ``precision``, ``recall``, ``score`` (K,) at IoU 0.5, one for each
    detection from the best score down, precision and recall being those at that threshold. ``found_iou`` (T,): for each
    true box, the IoU of its match at IoU 0.5, or 0 where it was missed.
    """

    images: int
    truths: int
    ap: Array
    precision: Array
    recall: Array
    score: Array
    found_iou: Array

    @property
    def ap50(self) -> float:
        return float(self.ap[0])

    @property
    def ap50_95(self) -> float:
        return float(self.ap.mean())

    def at_score(self, score: float) -> tuple[float, float]:
        """Precision and recall (IoU 0.5) with the detections of at least ``score``."""
        count = int(np.count_nonzero(self.score >= score))
        return (float(self.precision[count - 1]), float(self.recall[count - 1])) if count else (1.0, 0.0)


def evaluate_detections(
    found: Mapping[str, Sequence[Detection]], truth: Mapping[str, Sequence[Box]]
) -> DetectionQuality:
    """Compare detections with true boxes, both by image name; images without true boxes count as empty ones."""
    names = sorted(truth)
    kept = {n: sorted(found.get(n, ()), key=lambda d: -d.score)[:MOST_PER_IMAGE] for n in names}
    overlaps = {n: _iou_table([d.box_px for d in kept[n]], truth[n]) for n in names}
    scores = np.array([d.score for n in names for d in kept[n]], np.float64)
    order = np.argsort(-scores, kind="stable")
    count = sum(len(boxes) for boxes in truth.values())
    ap = np.zeros(len(IOUS))
    curves: list[tuple[Array, Array]] = []
    for k, threshold in enumerate(IOUS):
        hit = np.concatenate([_match(overlaps[n], threshold)[0] for n in names] or [np.zeros(0)])[order]
        recall = np.cumsum(hit) / max(count, 1)
        precision = np.cumsum(hit) / np.arange(1, len(hit) + 1)
        ap[k] = average_precision(precision, recall) if count else np.nan
        curves.append((precision, recall))
    found_iou = np.concatenate([_match(overlaps[n], IOUS[0])[1] for n in names] or [np.zeros(0)])
    return DetectionQuality(len(names), count, ap, *curves[0], scores[order], found_iou)


def average_precision(precision: Array, recall: Array) -> float:
    """The mean of the best precision at recall >= r, over r = 0, 0.01 ... 1 (COCO's 101 points)."""
    envelope = np.maximum.accumulate(precision[::-1])[::-1]
    at = np.searchsorted(recall, RECALLS, side="left")
    return float(np.where(at < len(envelope), np.append(envelope, 0.0)[np.minimum(at, len(envelope))], 0.0).mean())


def _iou_table(boxes: Sequence[Box], truths: Sequence[Box]) -> Array:
    """(detections, truths)"""
    a, b = np.array(boxes, np.float64).reshape(-1, 1, 4), np.array(truths, np.float64).reshape(1, -1, 4)
    size = np.minimum(a[..., :2] + a[..., 2:], b[..., :2] + b[..., 2:]) - np.maximum(a[..., :2], b[..., :2])
    shared = size.clip(min=0).prod(-1)
    union = a[..., 2:].prod(-1) + b[..., 2:].prod(-1) - shared
    return np.asarray(shared / np.maximum(union, 1e-12))


def _match(table: Array, threshold: float) -> tuple[Array, Array]:
    """Best score first, each detection takes the free true box that it overlaps most, if by ``threshold``.

    ``table`` (detections, truths) of IoUs -> hit (detections,) 0 or 1, and each true box's IoU (truths,), 0 if missed.
    """
    hit, taken = np.zeros(len(table)), np.zeros(table.shape[1])
    for k, row in enumerate(table):
        free = np.where(taken > 0, -1.0, row)
        best = int(free.argmax()) if len(free) else -1
        if best >= 0 and free[best] >= threshold - 1e-10:
            hit[k], taken[best] = 1, free[best]
    return hit, taken
