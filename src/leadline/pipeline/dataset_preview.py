"""All frames of a drawn set with their boxes on one page: whether the labels are good is seen at a glance."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import replace
from html import escape
from pathlib import Path
from string import Template

import cv2
import numpy as np

from leadline.evaluation.drawing import draw_detections
from leadline.evaluation.html import items as items_
from leadline.evaluation.html import section
from leadline.evaluation.svg import INK
from leadline.files import write_whole
from leadline.pipeline.dataset_files import Item, review_order
from leadline.wire.images import decode_image

WIDTH_PX = 240
_TEMPLATE = Path(__file__).parents[1] / "evaluation" / "calibration_report.html"


def write_preview(folder: Path, items: Sequence[Item], provenance: str) -> None:
    """``folder/preview.html``, in the order of ``review.csv``."""
    doubtful = [item for item in items if item.labels.doubts]
    boxes = sum(len(item.labels.boxes) for item in items)
    figures = "".join(_figure(folder, item) for item in review_order(items))
    page = Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(
        title="Frames to label",
        subtitle=escape(f"pre-labelled by {provenance}"),
        colour=INK["water"],
        verdict=f"{len(items)} frames with {boxes} boxes",
        doubts=items_([f"{len(doubtful)} of them are doubtful"]),
        next_action="correct the boxes in a labelling tool (README.md says how), then train",
        sections=section("Doubtful ones first", f'<div class="row">{figures}</div>'),
    )
    write_whole(folder / "preview.html", page)


def _figure(folder: Path, item: Item) -> str:
    image = decode_image((folder / "images" / item.file).read_bytes())
    scale = WIDTH_PX / image.shape[1]
    small = np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)
    boxes = [replace(box, box_px=tuple(scale * v for v in box.box_px)) for box in item.labels.boxes]
    small = draw_detections(small, boxes)
    data = base64.b64encode(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes()).decode("ascii")
    told = "; ".join(item.labels.doubts) or "no doubt"
    if item.labels.range_m is not None:
        told = f"{item.labels.range_m:.2f} m; {told}"
    caption = f"{escape(item.file)}<br>{escape(told)}"
    shown = f'<img width="{WIDTH_PX}" alt="" src="data:image/jpeg;base64,{data}">'
    return f"<figure>{shown}<figcaption>{caption}</figcaption></figure>"
