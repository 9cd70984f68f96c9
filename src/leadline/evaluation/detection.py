"""How good a detector is: precision, recall and average precision as COCO counts them, by pycocotools.

Boxes are x, y, w, h in one and the same pixel convention. Classes are not looked at: whoever needs several calls once
for each (COCO's figure is their mean) and once with all of them, for what was taken for what.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from leadline.samples import Array, Detection

IOUS = np.linspace(0.5, 0.95, 10)
MOST_PER_IMAGE = 100
CATEGORY = 1

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
    """AP over IoU thresholds and the precision-recall curve at IoU 0.5.

    ``ap`` (10,) at IoU 0.50, 0.55 ... 0.95, NaN without a true box. ``pairs``: one for each detection from the best
    score down; ``precision``, ``recall``, ``score`` (K,) go with them and are those at that threshold. ``found_iou``
    (T,): for each true box, image by image in order of name, the IoU of its match at IoU 0.5, or 0 where it was missed.
    """

    images: int
    truths: int
    ap: Array
    precision: Array
    recall: Array
    score: Array
    found_iou: Array
    pairs: tuple[Pair, ...]

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
    found: Mapping[str, Sequence[Detection]], truth: Mapping[str, Sequence[Box]]
) -> DetectionQuality:
    """Compare detections with true boxes, both by image name; images without true boxes count as empty ones."""
    names = sorted(truth)
    evaluator = _evaluate([found.get(name, ()) for name in names], [truth[name] for name in names])
    count = sum(len(boxes) for boxes in truth.values())
    ap = evaluator.eval["precision"][:, :, 0, 0, 0].mean(axis=1) if count else np.full(len(IOUS), np.nan)
    pairs = _pairs(evaluator, names, found, truth)
    hits = np.cumsum([pair.truth is not None for pair in pairs])
    found_iou = {(pair.image, pair.truth): pair.iou for pair in pairs}
    return DetectionQuality(
        images=len(names),
        truths=count,
        ap=np.asarray(ap, np.float64),
        precision=hits / np.arange(1, len(pairs) + 1),
        recall=hits / max(count, 1),
        score=np.array([pair.detection.score for pair in pairs], np.float64),
        found_iou=np.array([found_iou.get((name, k), 0.0) for name in names for k in range(len(truth[name]))]),
        pairs=tuple(pairs),
    )


def _evaluate(found: Sequence[Sequence[Detection]], truth: Sequence[Sequence[Box]]) -> Any:
    """pycocotools over images numbered from 0; boxes are numbered from 1, as it takes 0 for no match."""
    from pycocotools.coco import COCO  # type: ignore[import-untyped]  # noqa: PLC0415
    from pycocotools.cocoeval import COCOeval  # type: ignore[import-untyped]  # noqa: PLC0415

    def table(notes: list[dict[str, Any]]) -> Any:
        coco = COCO()
        images = [{"id": number} for number in range(len(truth))]
        notes = [{"id": k, "category_id": CATEGORY, "iscrowd": 0, **note} for k, note in enumerate(notes, 1)]
        coco.dataset = {"images": images, "categories": [{"id": CATEGORY}], "annotations": notes}
        coco.createIndex()
        return coco

    boxes = [{"image_id": i, "bbox": list(b), "area": b[2] * b[3]} for i, every in enumerate(truth) for b in every]
    results = [
        {"image_id": i, "bbox": list(d.box_px), "area": d.box_px[2] * d.box_px[3], "score": d.score}
        for i, every in enumerate(found)
        for d in every
    ]
    with contextlib.redirect_stdout(io.StringIO()):  # it tells its steps there
        evaluator = COCOeval(table(boxes), table(results), "bbox")
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
    """Every detection with its match at IoU 0.5, the best score first."""
    detections = [d for name in names for d in found.get(name, ())]
    number_in_image = [k for name in names for k in range(len(truth[name]))]
    pairs = []
    for one in filter(None, evaluator.evalImgs):
        image = one["image_id"]
        overlaps = evaluator.ious[image, CATEGORY]  # (detections, true boxes), empty where either is missing
        for row, (which, match) in enumerate(zip(one["dtIds"], one["dtMatches"][0], strict=True)):
            number = number_in_image[int(match) - 1] if match else None
            iou = 0.0 if number is None else float(overlaps[row][number])
            pairs.append(Pair(names[image], detections[which - 1], number, iou))
    return sorted(pairs, key=lambda pair: -pair.detection.score)
