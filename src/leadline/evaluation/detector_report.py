"""`leadline evaluate detector`, and the end of `leadline train`: how good a detector is on labelled images.

Writes the figures (summary.json), one page, the precision-recall curve, sheets of what went wrong, and all detections.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from leadline.errors import InputError
from leadline.evaluation import detection_page
from leadline.evaluation.detect import coco_results
from leadline.evaluation.detection import Box
from leadline.evaluation.detection_sheet import false_sheet, misses_sheet
from leadline.evaluation.detection_tables import COCO_SIDES_PX, Outcome, Picture, Row, size_name
from leadline.evaluation.detection_water import local_contrast, thirds
from leadline.evaluation.summary import versions
from leadline.files import make_folder, write_whole
from leadline.samples import Detection, Image
from leadline.training.dataset import Example
from leadline.wire.images import decode_image

PAGE, CURVE, SUMMARY, RESULTS = "detector.html", "pr_curve.svg", "summary.json", "detections.json"
MISSES, FALSE_BOXES = "misses.jpg", "false_boxes.jpg"
LEAST_SCORE = 0.01  # of the detections that the curve is made of: ask the detector for these
SCORE = 0.3  # at which is counted what was found and missed: the detector's own default

Detect = Callable[[Image], list[Detection]]
Progress = Callable[[int, int | None], None]


@dataclass(frozen=True, slots=True)
class WaterRow:
    """A third of the images by their contrast, with the boxes in it by COCO's sizes."""

    name: str
    images: int
    ap50: float
    all: Row
    by_size: list[Row]


@dataclass(frozen=True, slots=True)
class DetectorReport:
    """How good a detector is. AP: the mean over the classes, NaN without a labelled box; rows are at ``score``.

    ``confusion``: class names, and counts: true classes and nothing down, claimed classes and missed across.
    ``by_score``: score, precision, recall. ``notices``: what the user should know, a line each.
    """

    images: int
    boxes: int
    ap50: float
    ap75: float
    ap50_95: float
    ap50_by_class: dict[str, float]
    score: float
    all: Row
    recall_by_size: list[Row]
    by_water: list[WaterRow]
    by_clip: list[Row]
    confusion: tuple[list[str], list[list[int]]]
    by_score: list[tuple[float, float, float]]
    notices: list[str] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)

    @property
    def best_score(self) -> tuple[float, float, float]:
        """Score, precision and recall where these two are best together (F1)."""
        return max(self.by_score, key=lambda one: 2 * one[1] * one[2] / max(one[1] + one[2], 1e-9))


def write_detector_report(
    examples: Sequence[Example],
    detect: Detect,
    out: Path,
    names: Sequence[str],
    *,
    score: float = SCORE,
    title: str = "",
    notices: Sequence[str] = (),
    progress: Progress = lambda done, total: None,
) -> DetectorReport:
    """Run ``detect`` (BGR image -> detections of LEAST_SCORE and more, labelled with ``names``) on all examples.

    ``score``: at which is counted what was found, missed and made up. ``title`` says which model and which set;
    ``notices`` go on top of the page. Images that cannot be read are left out and told. InputError where that leaves
    none, where nothing is labelled, or where ``out`` cannot be written.
    """
    told = list(notices)
    pictures = _look(examples, detect, names, told, progress)
    outcome = Outcome(pictures, names, score)
    report = _report(outcome, told)
    files = {example.image.as_posix(): example.image for example in examples}
    sheets = {
        name: _jpeg(sheet)
        for name, make in ((MISSES, misses_sheet), (FALSE_BOXES, false_sheet))
        if (sheet := make(outcome, lambda picture: _load(files[picture.name]))) is not None
    }
    return _write(out, report, outcome, sheets, title)


def _look(
    examples: Sequence[Example], detect: Detect, names: Sequence[str], told: list[str], progress: Progress
) -> list[Picture]:
    pictures: list[Picture] = []
    broken: list[str] = []
    strange: dict[str, int] = {}
    for done, example in enumerate(examples, 1):
        try:
            image = _load(example.image)
        except (OSError, ValueError) as error:
            broken.append(f"{example.image.name}: {error}")
            continue
        found = detect(image)
        for detection in found:
            if detection.label not in names:
                strange[detection.label] = strange.get(detection.label, 0) + 1
        pictures.append(_picture(example, image, [d for d in found if d.label in names], names))
        progress(done, len(examples))
    if broken:
        told.append(f"{len(broken)} images cannot be read, the first {broken[0]}")
    if strange:
        told.append(f"detections of classes that are not evaluated, left out: {', '.join(sorted(strange))}")
    if not any(picture.truths for picture in pictures):
        raise InputError(
            f"{len(pictures)} images can be read, and none has a labelled box",
            str(examples[0].image.parent) if examples else "",
            "give images with labels",
        )
    return pictures


def _picture(example: Example, image: Image, found: list[Detection], names: Sequence[str]) -> Picture:
    boxes: list[Box] = [(x0 - 0.5, y0 - 0.5, x1 - x0, y1 - y0) for x0, y0, x1, y1 in example.boxes.tolist()]
    classes = example.classes.tolist()
    return Picture(
        name=example.image.as_posix(),
        clip=example.clip,
        contrast=local_contrast(image),
        truths=tuple((box, names[k]) for box, k in zip(boxes, classes, strict=True) if k >= 0),
        unsure=tuple(box for box, k in zip(boxes, classes, strict=True) if k < 0),
        found=tuple(found),
    )


def _load(path: Path) -> Image:
    image = decode_image(path.read_bytes())
    return image if image.ndim == 3 else np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), np.uint8)


def _report(outcome: Outcome, told: list[str]) -> DetectorReport:
    ap50, ap75, ap50_95 = outcome.ap()
    return DetectorReport(
        images=len(outcome.pictures),
        boxes=len(outcome.seen),
        ap50=ap50,
        ap75=ap75,
        ap50_95=ap50_95,
        ap50_by_class={name: q.ap50 for name, q in outcome.by_class.items() if q.truths},
        score=outcome.score,
        all=outcome.row("all"),
        recall_by_size=outcome.by_size(),
        by_water=_by_water(outcome),
        by_clip=outcome.by_clip(),
        confusion=outcome.confusion(),
        by_score=outcome.by_score(),
        notices=told,
    )


def _by_water(outcome: Outcome) -> list[WaterRow]:
    names, group = thirds(np.array([picture.contrast for picture in outcome.pictures]))
    rows = []
    for number, name in enumerate(names):
        held = [picture for picture, k in zip(outcome.pictures, group, strict=True) if k == number]
        among = {picture.name for picture in held}
        sizes = [outcome.row(size_name(*sides), among, sides) for sides in pairwise(COCO_SIDES_PX)]
        rows.append(WaterRow(name, len(held), outcome.ap(held)[0], outcome.row(name, among), sizes))
    return rows


def _write(out: Path, report: DetectorReport, outcome: Outcome, sheets: dict[str, bytes], title: str) -> DetectorReport:
    make_folder(out, without=(MISSES, FALSE_BOXES))
    results = [one for p in outcome.pictures for one in coco_results(Path(p.name).name, p.found)]
    curve = detection_page.curve(outcome)
    texts = {
        PAGE: detection_page.page(report, curve, sheets, title),
        CURVE: curve + "\n",
        SUMMARY: json.dumps(_plain(report, title), indent=1) + "\n",
        RESULTS: json.dumps(results, indent=1) + "\n",
    }
    for name, text in texts.items():
        write_whole(out / name, text)
    for name, data in sheets.items():
        write_whole(out / name, data)
    return replace(report, files=[out / name for name in (*texts, *sheets)])


def _jpeg(sheet: Image) -> bytes:
    return cv2.imencode(".jpg", sheet, [cv2.IMWRITE_JPEG_QUALITY, 88])[1].tobytes()


def _plain(report: DetectorReport, title: str) -> dict[str, Any]:
    """JSON knows no NaN: null."""
    names, counts = report.confusion
    score, precision, recall = report.best_score
    plain = asdict(report) | {
        "title": title,
        "confusion": {"true": [*names, "nothing there"], "claimed": [*names, "missed"], "counts": counts},
        "by_score": [dict(zip(("score", "precision", "recall"), one, strict=True)) for one in report.by_score],
        "best_score": {"score": score, "precision": precision, "recall": recall},
        "versions": dict(versions()),
    }
    del plain["files"]
    return dict(_without_nan(plain))


def _without_nan(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_nan(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(one) for one in value]
    return None if isinstance(value, float) and np.isnan(value) else value
