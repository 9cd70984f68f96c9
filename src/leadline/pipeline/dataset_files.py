"""A set of pre-labelled frames on disk: YOLO and COCO at once, tasks for Label Studio, and what to look at first."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import Any

import yaml

from leadline.pipeline.dataset_labels import DOUBTFUL, Labels
from leadline.samples import Detection
from leadline.wire.stamps import format_stamp

HALF_PX = 0.5  # the formats count from the first pixel's outer corner, leadline from its centre
_README = Path(__file__).with_name("dataset_readme.md")
REVIEW_COLUMNS = ("image", "look", "why", "boxes", "lowest_score", "range_m", "recording", "t_s")


@dataclass(frozen=True, slots=True)
class Item:
    """A frame of the set: ``file`` within images/, its size, where it is from, and its labels."""

    file: str
    size: tuple[int, int]
    recording: str
    t_ns: int
    labels: Labels


def write_set(folder: Path, items: Sequence[Item], names: Sequence[str], provenance: str) -> None:
    """All but the images, which stand in ``folder/images`` already."""
    (folder / "labels").mkdir()
    for item in items:
        rows = "".join(_yolo_row(box, item.size, names) for box in item.labels.boxes)
        (folder / "labels" / f"{Path(item.file).stem}.txt").write_text(rows, encoding="utf-8")
    head = (
        "# images/ and labels/ (YOLO); `leadline train` and `leadline evaluate detector` read this folder as it is.\n"
    )
    text = yaml.safe_dump({"names": list(names)}, sort_keys=False, allow_unicode=True)
    (folder / "data.yaml").write_text(head + text, encoding="utf-8")
    _write_json(folder / "annotations.json", _coco(items, names, provenance))
    _write_json(folder / "label_studio.json", [_task(item, provenance) for item in items])
    _write_review(folder / "review.csv", items)
    readme = Template(_README.read_text(encoding="utf-8"))
    labels = "\n".join(f'    <Label value="{name}"/>' for name in names)
    told = {"count": len(items), "provenance": provenance, "labels": labels, "doubtful": f"{DOUBTFUL:g}"}
    (folder / "README.md").write_text(readme.substitute(told), encoding="utf-8")


def _write_json(path: Path, content: Any) -> None:
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def corners(box: Detection, size: tuple[int, int]) -> tuple[float, float, float, float]:
    """x0, y0, x1, y1 from the image's outer corner, cut to the image."""
    x, y, w, h = box.box_px
    x0, y0, x1, y1 = x + HALF_PX, y + HALF_PX, x + w + HALF_PX, y + h + HALF_PX
    return max(x0, 0.0), max(y0, 0.0), min(x1, float(size[0])), min(y1, float(size[1]))


def _yolo_row(box: Detection, size: tuple[int, int], names: Sequence[str]) -> str:
    x0, y0, x1, y1 = corners(box, size)
    width, height = size
    values = ((x0 + x1) / 2 / width, (y0 + y1) / 2 / height, (x1 - x0) / width, (y1 - y0) / height)
    return f"{list(names).index(box.label)} " + " ".join(f"{value:.6f}" for value in values) + "\n"


def _coco(items: Sequence[Item], names: Sequence[str], provenance: str) -> dict[str, Any]:
    """COCO, with the score and who said so at each box, and where each image is from."""
    numbered = list(enumerate(items, 1))
    images = [
        {
            "id": number,
            "file_name": item.file,
            "width": item.size[0],
            "height": item.size[1],
            "recording": item.recording,
            "t_s": format_stamp(item.t_ns),
            "range_m": item.labels.range_m,
            "review": list(item.labels.doubts),
        }
        for number, item in numbered
    ]
    notes: list[dict[str, Any]] = []
    for number, item in numbered:
        for box in item.labels.boxes:
            x0, y0, x1, y1 = (round(v, 2) for v in corners(box, item.size))
            notes.append(
                {
                    "id": len(notes) + 1,
                    "image_id": number,
                    "category_id": list(names).index(box.label) + 1,
                    "bbox": [x0, y0, round(x1 - x0, 2), round(y1 - y0, 2)],
                    "area": round((x1 - x0) * (y1 - y0), 2),
                    "iscrowd": 0,
                    "score": round(box.score, 4),
                    "attributes": {"score": round(box.score, 4), "provenance": provenance},
                }
            )
    return {
        "info": {"description": f"pre-labelled by {provenance}; not yet looked at"},
        "licenses": [],
        "categories": [{"id": k, "name": name, "supercategory": ""} for k, name in enumerate(names, 1)],
        "images": images,
        "annotations": notes,
    }


def _task(item: Item, provenance: str) -> dict[str, Any]:
    """A Label Studio task with its prediction; percent of the image."""
    result = []
    for number, box in enumerate(item.labels.boxes):
        x0, y0, x1, y1 = corners(box, item.size)
        value = {
            "x": 100 * x0 / item.size[0],
            "y": 100 * y0 / item.size[1],
            "width": 100 * (x1 - x0) / item.size[0],
            "height": 100 * (y1 - y0) / item.size[1],
            "rotation": 0,
            "rectanglelabels": [box.label],
        }
        result.append(
            {
                "id": f"{Path(item.file).stem}-{number}",
                "type": "rectanglelabels",
                "from_name": "label",
                "to_name": "image",
                "original_width": item.size[0],
                "original_height": item.size[1],
                "image_rotation": 0,
                "value": value,
                "score": box.score,
            }
        )
    lowest = min((box.score for box in item.labels.boxes), default=0.0)
    data = {
        "image": f"/data/local-files/?d=images/{item.file}",
        "recording": item.recording,
        "review": "; ".join(item.labels.doubts),
    }
    return {"data": data, "predictions": [{"model_version": provenance, "score": lowest, "result": result}]}


def review_order(items: Sequence[Item]) -> list[Item]:
    """Doubtful ones first: those without a box, then from the lowest score up."""

    def key(item: Item) -> tuple[bool, float, str]:
        return not item.labels.doubts, min((box.score for box in item.labels.boxes), default=0.0), item.file

    return sorted(items, key=key)


def _write_review(path: Path, items: Sequence[Item]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(REVIEW_COLUMNS)
        for item in review_order(items):
            labels = item.labels
            scores = [box.score for box in labels.boxes]
            table.writerow(
                [
                    item.file,
                    "first" if labels.doubts else "later",
                    "; ".join(labels.doubts),
                    len(scores),
                    f"{min(scores):.3f}" if scores else "",
                    "" if labels.range_m is None else f"{labels.range_m:.3f}",
                    item.recording,
                    format_stamp(item.t_ns),
                ]
            )
