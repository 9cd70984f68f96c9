"""Labelled images on disk -> examples: Pascal VOC (Images + Annotations) and COCO (annotations.json beside images).

Boxes are (N, 4) x0 y0 x1 y1 in the formats' own pixels: (0, 0) is the outer corner of the first pixel.
"""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from leadline.errors import InputError

Floats = NDArray[np.float32]
IMAGE_SUFFIXES = {".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff"}


@dataclass(frozen=True, slots=True)
class Example:
    """One image file, its boxes (N, 4) and their class numbers (N,); -1: maybe a target, teach nothing there."""

    image: Path
    boxes: Floats
    classes: NDArray[np.int64]


def read_voc(folder: Path, names: Sequence[str], prefix: str | None = None) -> list[Example]:
    """``folder/Images`` with ``folder/Annotations``; objects whose name is none of ``names`` are left out.

    ``prefix``: every object whose name starts with it counts as ``names[0]``.
    """
    images = {path.stem: path for path in (folder / "Images").glob("*") if path.suffix.lower() in IMAGE_SUFFIXES}
    notes = sorted((folder / "Annotations").glob("*.xml"), key=lambda path: natural_key(path.stem))
    examples = [_voc_example(images[path.stem], path, names, prefix) for path in notes if path.stem in images]
    if not examples:
        raise InputError("no labelled images", str(folder), "give a folder with Images/ and Annotations/*.xml")
    return examples


def _voc_example(image: Path, note: Path, names: Sequence[str], prefix: str | None) -> Example:
    boxes: list[list[float]] = []
    classes: list[int] = []
    try:
        for item in ET.parse(note).getroot().iter("object"):
            name = item.findtext("name", "")
            if prefix is not None and name.startswith(prefix):
                name = names[0]
            if name in names:
                boxes.append([float(item.findtext(f"bndbox/{key}", "")) for key in ("xmin", "ymin", "xmax", "ymax")])
                classes.append(list(names).index(name))
    except (ET.ParseError, ValueError) as error:
        raise InputError(f"not a Pascal VOC annotation ({error})", str(note), "correct or remove it") from error
    return Example(image, np.array(boxes, np.float32).reshape(-1, 4), np.array(classes, np.int64))


def read_coco(file: Path) -> list[Example]:
    """A COCO annotation file; images lie beside it or in ``images/`` beside it."""
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
        order = {c["id"]: k for k, c in enumerate(sorted(data["categories"], key=lambda c: c["id"]))}
        found: dict[int, list[tuple[int, list[float]]]] = {image["id"]: [] for image in data["images"]}
        for note in data["annotations"]:
            found[note["image_id"]].append((order[note["category_id"]], [float(v) for v in note["bbox"]]))
        images = [(image["file_name"], found[image["id"]]) for image in data["images"]]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"not a COCO annotation file ({error!r})", str(file), "export it again as COCO") from error
    root = file.parent / "images" if (file.parent / "images").is_dir() else file.parent
    return [_coco_example(root / name, notes) for name, notes in images]


def _coco_example(image: Path, notes: list[tuple[int, list[float]]]) -> Example:
    boxes = np.array([box for _, box in notes], np.float32).reshape(-1, 4)
    boxes[:, 2:] += boxes[:, :2]
    return Example(image, boxes, np.array([number for number, _ in notes], np.int64))


def natural_key(name: str) -> tuple[tuple[int, str], ...]:
    """Sorts frame9 before frame10."""
    return tuple((int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name) if part)


def split_by_numbers(
    examples: Iterable[Example], held_out: Sequence[tuple[int, int]]
) -> tuple[list[Example], list[Example]]:
    """Training and held-out examples: held out are those whose file number lies in one of the ranges (both ends in).

    Neighbouring frames of a clip are all but the same picture, so whole clips are kept apart, never single frames.
    """
    train: list[Example] = []
    held: list[Example] = []
    for example in examples:
        numbers = re.findall(r"\d+", example.image.stem)
        number = int(numbers[-1]) if numbers else -1
        (held if any(first <= number <= last for first, last in held_out) else train).append(example)
    return train, held
