"""Labelled images on disk -> examples. Needs no torch.

Boxes are (N, 4) x0 y0 x1 y1 in the formats' own pixels: (0, 0) is the outer corner of the first pixel.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from leadline.errors import InputError
from leadline.training.clips import clip_names, read_clips
from leadline.training.formats import CROWD, Entry, Found, Labelled, find_labels, natural_key

Floats = NDArray[np.float32]
Ints = NDArray[np.int64]
UNSURE = -1  # the class of a box in which there may be a target: nothing is taught there
OUTSIDE_PX = 1.5  # a box that ends so little outside the image is rounding, not a fault


@dataclass(frozen=True, slots=True)
class Example:
    """One image file, its boxes (N, 4) and their class numbers (N,); -1: maybe a target, teach nothing there.

    ``clip`` names the recording it is from; ``part`` is train, val or test where the set has a split of its own.
    """

    image: Path
    boxes: Floats
    classes: Ints
    clip: str = ""
    part: str | None = None


@dataclass(frozen=True, slots=True)
class Dataset:
    """A set of labelled images. ``notices``: what the user should know of it, a line each; ``troubles``: (file, why)
    of everything that was left out."""

    path: Path
    format: str
    examples: tuple[Example, ...]
    names: tuple[str, ...]
    notices: tuple[str, ...] = ()
    troubles: tuple[tuple[str, str], ...] = ()

    def digest(self) -> str:
        """SHA-256 over all images' bytes, boxes and classes, in order: says which data a model has seen."""
        total = hashlib.sha256(repr(self.names).encode())
        for example in self.examples:
            total.update(hashlib.sha256(example.image.read_bytes()).digest())
            total.update(np.round(example.boxes.astype("<f8"), 2).tobytes())
            total.update(example.classes.astype("<i8").tobytes())
        return total.hexdigest()


def read_dataset(
    path: Path,
    classes: str | None = None,
    clips: Path | None = None,
    progress: Callable[[int, int | None], None] = lambda done, total: None,
) -> Dataset:
    """Read a YOLO, COCO or Pascal VOC set; which it is, is told from its files.

    ``classes`` keeps some of the set's classes, comma-separated: names or patterns (``buoy_*``), each as itself, or
    merged under a new name (``ball=buoy_*,ball=float``). ``clips`` is a CSV file ``image,clip[,part]``; without it
    clips are told from folders and file names. Every image is decoded once: what cannot be read is left out and told.
    Raises InputError where nothing usable is left.
    """
    found = find_labels(Path(path))
    read: list[tuple[Entry, list[Labelled]]] = []
    outside = _Count()
    for done, entry in enumerate(found.entries, 1):
        progress(done, len(found.entries))
        try:
            size = _image_size(entry.image)
            labels = [(name, _inside(box, size, entry.image, outside)) for name, box in entry.read(size)]
        except (ValueError, OSError) as error:
            found.troubles.append((str(entry.image), str(error)))
            continue
        read.append((entry, [(name, box) for name, box in labels if box]))
    names, renamed = _choose_classes(found, read, classes, Path(path))
    examples = _with_clips([_example(entry, labels, names, renamed) for entry, labels in read], Path(path), clips)
    _require_boxes(examples, found, Path(path))
    remarks = [*found.remarks, *outside.remarks(), *_trouble_lines(found.troubles)]
    return Dataset(Path(path), found.format, tuple(examples), names, tuple(remarks), tuple(found.troubles))


def _image_size(image: Path) -> tuple[int, int]:
    """Width and height as OpenCV gives the image (turned as its EXIF entry says): what training will see."""
    data = np.frombuffer(image.read_bytes(), np.uint8)
    pixels = cv2.imdecode(data, cv2.IMREAD_COLOR) if len(data) else None
    if pixels is None:
        raise ValueError("not a readable image")
    return pixels.shape[1], pixels.shape[0]


class _Count:
    """Boxes cut or dropped because they lie outside their image."""

    def __init__(self) -> None:
        self.cut: list[str] = []
        self.dropped: list[str] = []

    def remarks(self) -> list[str]:
        told = {
            "boxes reach out of their image and are cut to it": self.cut,
            "boxes are empty or outside their image and are left out": self.dropped,
        }
        return [f"{len(names)} {what}, the first in {names[0]}" for what, names in told.items() if names]


Corners = tuple[float, float, float, float]


def _inside(box: Corners, size: tuple[int, int], image: Path, count: _Count) -> Corners | None:
    """The box cut to its image, None where nothing is left."""
    if not np.isfinite(box).all():
        raise ValueError(f"a box of it is not finite: {box}")
    limit = np.array([*size, *size], np.float64)
    cut = np.clip(box, 0, limit)
    if min(cut[2] - cut[0], cut[3] - cut[1]) < 1:
        count.dropped.append(image.name)
        return None
    if np.abs(cut - box).max() > OUTSIDE_PX:
        count.cut.append(image.name)
    return float(cut[0]), float(cut[1]), float(cut[2]), float(cut[3])


def _choose_classes(
    found: Found, read: list[tuple[Entry, list[Labelled]]], classes: str | None, path: Path
) -> tuple[tuple[str, ...], dict[str, str]]:
    """The names to teach, in order, and which of the set's classes becomes which of them."""
    present = {name for _, labels in read for name, _ in labels} - {CROWD}
    known = found.names if found.names is not None else sorted(present, key=natural_key)
    if classes is None:
        return tuple(known), {name: name for name in known}
    renamed: dict[str, str] = {}
    for rule in classes.split(","):
        new, _, pattern = rule.strip().rpartition("=")
        matching = [name for name in known if fnmatchcase(name, pattern.strip())]
        if not matching:
            has = ", ".join(known) or "none"
            raise InputError(f"no class {pattern.strip()!r}", str(path), f"its classes: {has}")
        renamed |= {name: new.strip() or name for name in matching}
    return tuple(dict.fromkeys(renamed.values())), renamed


def _example(entry: Entry, labels: list[Labelled], names: tuple[str, ...], renamed: dict[str, str]) -> Example:
    kept = [(UNSURE if name == CROWD else names.index(renamed[name]), box) for name, box in labels
            if name == CROWD or name in renamed]  # fmt: skip
    boxes = np.array([box for _, box in kept], np.float32).reshape(-1, 4)
    return Example(entry.image, boxes, np.array([number for number, _ in kept], np.int64), part=entry.part)


def _with_clips(examples: list[Example], root: Path, file: Path | None) -> list[Example]:
    if file is None:
        names = clip_names([example.image for example in examples], root)
        return [replace(example, clip=name) for example, name in zip(examples, names, strict=True)]
    given = read_clips(file)
    missing = [example.image.name for example in examples if example.image.name not in given]
    if missing:
        raise InputError(f"{len(missing)} images have no row, the first {missing[0]}", str(file), "add image,clip rows")
    rows = [given[example.image.name] for example in examples]
    return [replace(e, clip=clip, part=part or e.part) for e, (clip, part) in zip(examples, rows, strict=True)]


def _require_boxes(examples: list[Example], found: Found, path: Path) -> None:
    if not examples:
        why = "; the first: " + ": ".join(found.troubles[0]) if found.troubles else ""
        raise InputError(f"no labelled image can be used{why}", str(path), "correct or replace the files")
    if not any((example.classes >= 0).any() for example in examples):
        raise InputError(f"not one box in {len(examples)} images", str(path), "label the target, or check --classes")


def _trouble_lines(troubles: list[tuple[str, str]]) -> list[str]:
    """One line for all files that were left out for the same kind of reason."""
    kinds: dict[str, list[tuple[str, str]]] = {}
    for file, why in troubles:
        kinds.setdefault("labels without an image" if "no image" in why else "images", []).append((file, why))
    return [f"{len(them)} {kind} left out, the first: {': '.join(them[0])}" for kind, them in kinds.items()]


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
