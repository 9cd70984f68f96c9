"""Small labelled sets, written in the formats that labelling tools write."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

Box = tuple[str, float, float, float, float]  # class, x0 y0 x1 y1
WIDTH, HEIGHT = 64, 48


def picture(path: Path, boxes: Sequence[Box] = (), size: tuple[int, int] = (WIDTH, HEIGHT)) -> Path:
    """A blue image with an orange block in each box."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image = np.full((size[1], size[0], 3), (120, 90, 20), np.uint8)
    for _, x0, y0, x1, y1 in boxes:
        image[int(y0) : int(y1), int(x0) : int(x1)] = (20, 90, 230)
    cv2.imwrite(str(path), image)
    return path


def voc(root: Path, images: dict[str, Sequence[Box]], stated_size: bool = True) -> Path:
    for name, boxes in images.items():
        image = picture(root / "Images" / name, boxes)
        size = f"<size><width>{WIDTH}</width><height>{HEIGHT}</height></size>" if stated_size else ""
        objects = "".join(
            f"<object><name>{label}</name><bndbox><xmin>{x0}</xmin><ymin>{y0}</ymin><xmax>{x1}</xmax><ymax>{y1}</ymax>"
            "</bndbox></object>"
            for label, x0, y0, x1, y1 in boxes
        )
        note = root / "Annotations" / f"{image.stem}.xml"
        note.parent.mkdir(exist_ok=True)
        note.write_text(f"<annotation><filename>{name}</filename>{size}{objects}</annotation>")
    return root


def coco(root: Path, images: dict[str, Sequence[Box]], file: str = "annotations.json") -> Path:
    names = sorted({label for boxes in images.values() for label, *_ in boxes})
    numbers = {name: 10 * (len(names) - k) for k, name in enumerate(names)}  # ids need neither start at 0 nor be sorted
    notes = []
    for k, (name, boxes) in enumerate(images.items()):
        picture((root / file).parent / name, boxes)
        for label, x0, y0, x1, y1 in boxes:
            box = [x0, y0, x1 - x0, y1 - y0]
            notes.append({"id": len(notes), "image_id": k, "category_id": numbers[label], "bbox": box})
    data = {
        "images": [{"id": k, "file_name": name, "width": WIDTH, "height": HEIGHT} for k, name in enumerate(images)],
        "categories": [{"id": number, "name": name} for name, number in numbers.items()],
        "annotations": notes,
    }
    (root / file).write_text(json.dumps(data))
    return root


def yolo(root: Path, images: dict[str, Sequence[Box]], names: Sequence[str], yaml: str | None = None) -> Path:
    """``images`` by path below images/, e.g. train/1.png."""
    for name, boxes in images.items():
        picture(root / "images" / name, boxes)
        file = (root / "labels" / name).with_suffix(".txt")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(
            "".join(
                f"{names.index(label)} {(x0 + x1) / 2 / WIDTH} {(y0 + y1) / 2 / HEIGHT} "
                f"{(x1 - x0) / WIDTH} {(y1 - y0) / HEIGHT}\n"
                for label, x0, y0, x1, y1 in boxes
            )
        )
    (root / "data.yaml").write_text(yaml or f"train: images\nval: images\nnames: {list(names)}\n")
    return root
