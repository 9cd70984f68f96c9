"""How good a detector is: precision, recall and average precision as COCO counts them, by pycocotools.

Boxes are x, y, w, h in one and the same pixel convention. Classes are not looked at: whoever needs several calls once
for each (COCO's figure is their mean) and once with all of them, for what was taken for what.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from leadline.samples import Array, Detection

IOUS = np.linspace(0.5, 0.95, 10)
RECALLS = np.linspace(0, 1, 101)
MOST_PER_IMAGE = 100
CATEGORY = 1
_NONE: Mapping[str, Sequence[tuple[float, float, float, float]]] = MappingProxyType({})

Box = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Pair:
    """A detection and the true box that it matches at IoU 0.5: ``truth`` its number in the image, None: false."""

    image: str
    detection: Detection
    truth: int | None
    iou: float


@dataclass(frozen=True, slots=True)
class DetectionQuality:
    """The precision-recall curves of a detector, and what it found.

    ``curves`` (10, 101): the best precision at a recall of at least 0, 0.01 ... 1 for IoU 0.50, 0.55 ... 0.95, NaN
    without a true box. ``pairs``: one for each detection from the best score down; ``precision``, ``recall``, ``score``
    (K,) go with them and are those at that threshold and IoU 0.5. ``found_iou`` (T,): for each true box, image by image
    in order of name, the IoU of its match at IoU 0.5, or 0 where it was missed.
    """

    images: int
    truths: int
    curves: Array
    precision: Array
    recall: Array
    score: Array
    found_iou: Array
    pairs: tuple[Pair, ...]

    @property
    def ap(self) -> Array:
        """(10,) average precision at IoU 0.50, 0.55 ... 0.95."""
        return np.asarray(self.curves.mean(axis=1))

    @property
    def ap50(self) -> float:
        return float(self.ap[0])

    @property
    def ap75(self) -> float:
        return float(self.ap[5])

    @property
    def ap50_95(self) -> float:
        return float(self.ap.mean())

    def at_score(self, score: float) -> tuple[float, float]:
        """Precision and recall (IoU 0.5) with the detections of at least ``score``."""
        count = int(np.count_nonzero(self.score >= score))
        return (float(self.precision[count - 1]), float(self.recall[count - 1])) if count else (1.0, 0.0)


def evaluate_detections(
    found: Mapping[str, Sequence[Detection]],
    truth: Mapping[str, Sequence[Box]],
    unsure: Mapping[str, Sequence[Box]] = _NONE,
) -> DetectionQuality:
    """Compare detections with true boxes, both by image name; images without true boxes count as empty ones.

    A detection that lies in an ``unsure`` box (maybe a target, or many) and on no true one is neither right nor false.
    """
    names = sorted(truth)
    evaluator = _evaluate(
        [found.get(n, ()) for n in names], [truth[n] for n in names], [unsure.get(n, ()) for n in names]
    )
    count = sum(len(boxes) for boxes in truth.values())
    curves = evaluator.eval["precision"][:, :, 0, 0, 0] if count else np.full((len(IOUS), len(RECALLS)), np.nan)
    pairs = _pairs(evaluator, names, found, truth)
    hits = np.cumsum([pair.truth is not None for pair in pairs])
    found_iou = {(pair.image, pair.truth): pair.iou for pair in pairs}
    return DetectionQuality(
        images=len(names),
        truths=count,
        curves=np.asarray(curves, np.float64),
        precision=hits / np.arange(1, len(pairs) + 1),
        recall=hits / max(count, 1),
        score=np.array([pair.detection.score for pair in pairs], np.float64),
        found_iou=np.array([found_iou.get((name, k), 0.0) for name in names for k in range(len(truth[name]))]),
        pairs=tuple(pairs),
    )


def _evaluate(
    found: Sequence[Sequence[Detection]], truth: Sequence[Sequence[Box]], unsure: Sequence[Sequence[Box]]
) -> Any:
    """pycocotools over images numbered from 0; boxes are numbered from 1, the true ones first: 0 is no match to it."""
    from pycocotools.coco import COCO  # type: ignore[import-untyped]  # noqa: PLC0415
    from pycocotools.cocoeval import COCOeval  # type: ignore[import-untyped]  # noqa: PLC0415

    def notes(boxes: Sequence[Sequence[Box]], **more: int) -> list[dict[str, Any]]:
        return [
            {"image_id": i, "category_id": CATEGORY, "bbox": list(b), "area": b[2] * b[3], **more}
            for i, every in enumerate(boxes)
            for b in every
        ]

    def table(annotations: list[dict[str, Any]]) -> Any:
        coco = COCO()
        numbered = [{"id": k, **note} for k, note in enumerate(annotations, 1)]
        images = [{"id": number} for number in range(len(truth))]
        coco.dataset = {"images": images, "categories": [{"id": CATEGORY}], "annotations": numbered}
        coco.createIndex()
        return coco

    boxes = notes(truth, iscrowd=0) + notes(unsure, iscrowd=1)
    scores = [d.score for every in found for d in every]
    results = notes([[d.box_px for d in every] for every in found])
    with contextlib.redirect_stdout(io.StringIO()):  # it tells its steps there
        scored = [{**note, "score": score} for note, score in zip(results, scores, strict=True)]
        evaluator = COCOeval(table(boxes), table(scored), "bbox")
        evaluator.params.iouThrs = IOUS
        evaluator.params.maxDets = [MOST_PER_IMAGE]
        evaluator.params.areaRng, evaluator.params.areaRngLbl = [[0, 1e10]], ["all"]
        evaluator.evaluate()
        evaluator.accumulate()
    return evaluator


def _pairs(
    evaluator: Any,
    names: Sequence[str],
    found: Mapping[str, Sequence[Detection]],
    truth: Mapping[str, Sequence[Box]],
) -> list[Pair]:
    """Every detection that counts with its match at IoU 0.5, the best score first."""
    detections = [d for name in names for d in found.get(name, ())]
    number_in_image = [k for name in names for k in range(len(truth[name]))]
    pairs = []
    for one in filter(None, evaluator.evalImgs):
        image = one["image_id"]
        overlaps = evaluator.ious[image, CATEGORY]  # (detections, true boxes), empty where either is missing
        for row, which in enumerate(one["dtIds"]):
            if one["dtIgnore"][0][row]:
                continue
            match = int(one["dtMatches"][0][row])
            number = number_in_image[match - 1] if match else None
            iou = 0.0 if number is None else float(overlaps[row][number])
            pairs.append(Pair(names[image], detections[which - 1], number, iou))
    return sorted(pairs, key=lambda pair: -pair.detection.score)
